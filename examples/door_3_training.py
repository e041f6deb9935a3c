"""Train an agent on options. All agents learn from SMDP transitions, and a flat room is the case k = 1."""

import itertools
from pathlib import Path

import gymnasium
import tyro

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import play_episode, train
from hrl_escape.options.options_env import OptionsEnv


def main(agent: str = "smdp-dqn+primitives", primitives: int = 20_000, seed: int = 0, out: Path | None = None) -> None:
    """Train, then print the learning curve and the first decisions of an episode.

    Args:
        agent: `smdp-dqn+primitives`, `smdp-q-learning+primitives`, `smdp-ppo+primitives`, ...
        primitives: training budget.
        seed: seed of the training run.
        out: folder for log and checkpoints; a stopped run resumes from there.
    """
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features"))
    result = train(agent, env, primitives=primitives, seed=seed, out=out)
    for trained, value in zip(*result.curve("mean_return"), strict=True):
        print(f"{trained:8,.0f} primitives: return {value:8.1f}")
    assert result.agent is not None
    for transition, info in itertools.islice(play_episode(result.agent, env, seed=1), 20):
        print(f"{info['option']['name']}: {transition.duration} primitives, reward {transition.summed_reward:g}")


if __name__ == "__main__":
    tyro.cli(main)
