"""DQN and PPO reach CartPole-v1's reward threshold of 475; `benchmarks/cartpole.py` does it with more seeds."""

import gymnasium
import pytest

from hrl_escape.agents import train


@pytest.mark.parametrize(("name", "primitives"), [("dqn", 10_000), ("ppo", 10_000)])
def test_cartpoles_threshold_is_reached(name, primitives):
    env = gymnasium.make("CartPole-v1")
    result = train(name, env, primitives=primitives, seed=2, eval_every=2_500, eval_episodes=20)
    assert max(evaluation.mean_return for evaluation in result.evaluations) >= 475
