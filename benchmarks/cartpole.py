"""DQN and PPO on Gymnasium's CartPole-v1, whose reward threshold is 475: are the agents sound on a known task?

    python benchmarks/cartpole.py            # two agents, three seeds, a few minutes on one core

An agent reaches the threshold when the mean return of 100 greedy evaluation episodes is 475 or more. The run
stops there, so the primitives printed are how much experience that took, to the next evaluation.
"""

from __future__ import annotations

import argparse
import time

import gymnasium
import torch

from hrl_escape.agents import evaluate, make_agent
from hrl_escape.agents.agent import make_transition, read_action_mask

THRESHOLD = 475.0
EVALUATE_EVERY = 5_000
EPISODES = 100


def find_primitives_to_threshold(name: str, seed: int, budget: int) -> tuple[int, float, float]:
    """Train until the threshold is reached.

    Returns:
        Primitives used, mean return of the last evaluation, seconds of training.
    """
    env, eval_env = gymnasium.make("CartPole-v1"), gymnasium.make("CartPole-v1")
    agent = make_agent(name, env.observation_space, env.action_space, seed)
    observation, info = env.reset(seed=seed)
    mask = read_action_mask(info, 2)
    seconds, started, score = 0.0, time.perf_counter(), 0.0
    for primitives in range(1, budget + 1):
        action = agent.act(observation, mask)
        transition = make_transition(observation, action, mask, env.step(action), agent.gamma)
        agent.observe(transition)
        observation, mask = transition.next_observation, transition.next_action_mask
        if transition.terminated or transition.truncated:
            observation, info = env.reset()
            mask = read_action_mask(info, 2)
        if primitives % EVALUATE_EVERY == 0:
            seconds += time.perf_counter() - started
            score = evaluate(agent, eval_env, EPISODES, seed=0).mean_return
            if score >= THRESHOLD:
                return primitives, score, seconds
            started = time.perf_counter()
    return budget, score, seconds


def main() -> None:
    """Print a line for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", nargs="+", default=["dqn", "ppo"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--budget", type=int, default=100_000, help="primitives after which a run gives up")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for name in arguments.agents:
        for seed in range(arguments.seeds):
            primitives, score, seconds = find_primitives_to_threshold(name, seed, arguments.budget)
            verdict = "reaches" if score >= THRESHOLD else "misses"
            cost = f"{primitives:,} primitives, {seconds:.0f} s"
            print(f"{name} seed {seed}: {verdict} {THRESHOLD:.0f} with {score:.1f} after {cost}")


if __name__ == "__main__":
    main()
