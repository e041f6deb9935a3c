"""Option-critic in Four Rooms against SARSA and Q-learning: recovery after the goal has moved.

The goal is the east hallway for the first half of the episodes, then a cell of the south-east room, drawn by seed.

Examples:
    python -m benchmarks.option_critic --seeds 20
    python -m benchmarks.option_critic --tune
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import tyro

from hrl_escape.agents.agent import Agent, SMDPTransition, make_transition
from hrl_escape.agents.algorithms.options.option_critic import OptionCritic
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.components.exploration import sample_action
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import EAST_HALLWAY, SOUTH_EAST_GOALS, FourRooms

STARTS = [cell for cell in range(104) if cell != EAST_HALLWAY]
MASK = np.ones(4, np.bool_)
PUBLISHED: dict[str, Any] = {"gamma": 0.99, "reward_scale": 1.0}
"""The defaults of option-critic are the settings of the program of 2017."""
TUNED: dict[str, Any] = {"gamma": 0.99, "learning_rate": 0.5, "epsilon_start": 0.01, "epsilon_end": 0.01,
                         "initial_value": 1.0}
"""Settings of Q-learning, the best of 12 by `--tune --episodes 600`, on seeds that the table does not use."""


class Sarsa(QLearning):
    """The baseline of 2017: SARSA with a Boltzmann policy of temperature 0.01."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._next: int | None = None

    def act(self, observation: Any, action_mask: Any) -> int:
        """Take the action that the last update was made with."""
        action, self._next = self._next, None
        return super().act(observation, action_mask) if action is None else action

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Back up the value of the very next action."""
        values = self.compute_values(transition.next_observation)
        after = sample_action(values, MASK, self.settings, 0, self._rng)
        self._next = None if transition.terminated or transition.truncated else after
        target = transition.reward + (0.0 if transition.terminated else self.gamma * values[after])
        self.table.update(self._discretise(transition.observation), transition.action, target)
        return {}


def make_learners() -> dict[str, tuple[type[Agent], dict[str, Any]]]:
    """Name in the table -> class and settings."""
    boltzmann = {"gamma": 0.99, "learning_rate": 0.5, "exploration": "boltzmann", "temperature": 0.01}
    return {
        "SARSA, Boltzmann (2017)": (Sarsa, boltzmann),
        "q-learning": (QLearning, TUNED),
        "option-critic": (OptionCritic, PUBLISHED),
        "margin 0.01": (OptionCritic, PUBLISHED | {"termination_margin": 0.01}),
        "deliberation cost 0.01": (OptionCritic, PUBLISHED | {"deliberation_cost": 0.01}),
        "all options at once, 0.3": (OptionCritic, PUBLISHED | {"multi_option": 0.3}),
        "8 options": (OptionCritic, PUBLISHED | {"options": 8}),
        "1 option": (OptionCritic, PUBLISHED | {"options": 1}),
    }


@dataclasses.dataclass(frozen=True)
class Args:
    """Options."""

    seeds: int = 20
    """Seeds a row."""
    first_seed: int = 0
    """The first of them."""
    episodes: int = 2_000
    """Episodes a seed; the goal moves after half of them."""
    slip: Literal["extra", "neighbour"] = "extra"
    """Slip of the published program, `extra`, or of the text, `neighbour`."""
    learners: tuple[str, ...] = ()
    """Rows; all by default."""
    tune: bool = False
    """Tune Q-learning, on seeds 100 to 102."""


def run(agent_class: Any, settings: dict[str, Any], seed: int, args: Args) -> tuple[np.ndarray, list[float]]:
    """Primitives of every episode, and of option learners the mean duration at the half and at the end."""
    rng = np.random.default_rng([seed, 7])
    moved = int(rng.choice([goal for goal in SOUTH_EAST_GOALS if goal != EAST_HALLWAY]))
    env = FourRooms(EAST_HALLWAY, args.slip)
    agent: Agent = agent_class(env.observation_space, env.action_space, seed, agent_class.Settings(**settings))
    env.reset(seed=seed)
    steps, durations = np.zeros(args.episodes), []
    for episode in range(args.episodes):
        if episode == args.episodes // 2:
            durations.append(measure_duration(agent))
            env = FourRooms(moved, args.slip, [start for start in STARTS if start != moved])
            env.reset(seed=seed + 1_000_000_000)
        observation, _ = env.reset()
        over = False
        while not over:
            action = agent.act(observation, MASK)
            transition = make_transition(observation, action, MASK, env.step(action), agent.gamma)
            agent.observe(transition)
            observation, over = transition.next_observation, transition.terminated or transition.truncated
            steps[episode] += 1
    durations.append(measure_duration(agent))
    return steps, durations


def measure_duration(agent: Agent) -> float:
    """Mean decisions of the latest runs of options; NaN of an agent without options."""
    return agent.log.compute_duration() if isinstance(agent, OptionCritic) else math.nan


def summarise(rows: list[np.ndarray]) -> str:
    """Mean and standard error over seeds of five windows of episodes."""
    table = np.array(rows)
    half = table.shape[1] // 2
    windows = ((0, 50), (half - 100, half), (half, half + 50), (half + 50, half + 200), (-100, None))
    means = [table[:, slice(*window)].mean(axis=1) for window in windows]
    return " | ".join(f"{mean.mean():.1f} +- {mean.std(ddof=1) / len(mean) ** 0.5:.1f}" for mean in means)


def tune(args: Args) -> None:
    """Print the mean steps of every setting of Q-learning, the best last."""
    found = []
    grid = itertools.product((0.25, 0.5, 1.0), (0.01, 0.05), (0.0, 1.0))
    for rate, epsilon, first in grid:
        settings = {"gamma": 0.99, "learning_rate": rate, "epsilon_start": epsilon, "epsilon_end": epsilon,
                    "initial_value": first}
        means = [run(QLearning, settings, seed, args)[0].mean() for seed in range(100, 103)]
        found.append((float(np.mean(means)), settings))
    for mean, settings in sorted(found, key=lambda row: -row[0]):
        print(f"{mean:.1f}", settings)


def main(args: Args) -> None:
    """Print a table."""
    warnings.simplefilter("ignore")
    if args.tune:
        tune(args)
        return
    tables = FourRooms(EAST_HALLWAY, args.slip).make_tables()
    print(f"slip: {args.slip}; floor before the move {find_fewest_primitives(tables) @ tables.starts:.2f}")
    print("| learner | 0-49 | last 100 | 50 after the move | next 150 | last 100 | duration before, at the end |")
    print("|---|---|---|---|---|---|---|")
    for name, (agent_class, settings) in make_learners().items():
        if args.learners and name not in args.learners:
            continue
        runs = [run(agent_class, settings, args.first_seed + seed, args) for seed in range(args.seeds)]
        half, end = np.mean([durations for _, durations in runs], axis=0)
        lasts = "" if math.isnan(half) else f"{half:.2f}, {end:.2f}"
        print(f"| {name} | {summarise([steps for steps, _ in runs])} | {lasts} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Args))
