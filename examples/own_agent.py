"""Your own agent in 40 lines: Monte Carlo control over decisions of any duration.

These members are the whole contract of `hrl_escape.agents.Agent`. `train` adds curves, logs, checkpoints and resuming.
To use the agent in `hrl-escape compare`, publish it under the entry-point group `hrl_escape.agents`.
"""

from dataclasses import dataclass

import gymnasium
import numpy as np
import tyro

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import Agent, AgentSettings, SMDPTransition, train
from hrl_escape.options.options_env import OptionsEnv


@dataclass(frozen=True)
class MonteCarloSettings(AgentSettings):
    """Settings of Monte Carlo control."""

    gamma: float = 0.99
    """Discount per primitive."""
    epsilon: float = 0.2
    """Share of random decisions in training."""


class MonteCarlo(Agent):
    """Q(s, o) is the mean return after o in s, where s is the rounded observation."""

    Settings = MonteCarloSettings
    STATE = ("table", "rng")  # everything that learning depends on, between episodes

    def __init__(self, observation_space, action_space, seed, settings=None):
        """Make an empty table."""
        self.settings = settings or MonteCarloSettings()
        self.actions, self.rng = int(action_space.n), np.random.default_rng(seed)
        self.table, self.episode = {}, []  # key -> [sum of returns, visits], (2, actions); decisions so far

    def read(self, observation):
        """Return the sums and counts of returns at an observation, (2, actions)."""
        key = ",".join(map(str, np.round(observation * 4).astype(int)))
        return self.table.setdefault(key, np.zeros((2, self.actions)))

    def act(self, observation, action_mask):
        """Choose epsilon-greedily."""
        if self.rng.random() < self.settings.epsilon:
            return int(self.rng.choice(np.flatnonzero(action_mask)))
        return self.act_greedy(observation, action_mask, self.rng)

    def act_greedy(self, observation, action_mask, rng):
        """Choose the best mean return; untried actions come first."""
        total, visits = self.read(observation)
        means = np.where(visits > 0, total / np.maximum(visits, 1), 1e3)
        return int(np.argmax(np.where(action_mask, means, -np.inf)))

    def observe(self, transition: SMDPTransition):
        """At the end of the episode, add up G = R + gamma^k G' backwards over its decisions."""
        self.episode.append((self.read(transition.observation), transition))
        if not (transition.terminated or transition.truncated):
            return {}
        future = 0.0
        for row, step in reversed(self.episode):
            future = step.reward + step.discount * future
            row[:, step.action] += future, 1
        self.episode = []
        return {"value": future}


def main(primitives: int = 10_000) -> None:
    """Train in the room with two buttons.

    Args:
        primitives: training budget.
    """
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features"),
                     include_primitives=False)
    result = train(MonteCarlo(env.observation_space, env.action_space, seed=0), env, primitives=primitives)
    first, last = result.evaluations[0], result.evaluations[-1]
    print(f"return {first.mean_return:g} untrained, {last.mean_return:g} after {result.primitives:,} primitives")


if __name__ == "__main__":
    tyro.cli(main)
