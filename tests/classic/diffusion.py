"""Random walks over primitives and options, by linear solves: diffusion times and cover times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hrl_escape.agents.discovery import NOTHING, TableSkill
from tests.classic.exact import Array
from tests.classic.tabular import Tables


def make_next_states(tables: Tables) -> np.ndarray:
    """(states, actions) of a deterministic environment."""
    assert (np.isin(tables.probability, (0, 1))).all()
    return tables.probability.argmax(axis=2)


def compute_diffusion_time(after: np.ndarray, skills: Sequence[TableSkill]) -> tuple[float, float]:
    """Mean over ordered pairs of expected primitives, and of decisions, from one state to another.

    The walk chooses uniformly among primitives and the options that may begin; an option is over where it has no
    action, and stops at the goal on its way.

    Args:
        after: (states, actions), the next state.
        skills: the options.
    """
    states, actions = after.shape
    paths = [[_follow(after, skill, state) for state in range(states)] for skill in skills]
    totals = np.zeros(2)
    for goal in range(states):
        follow, price, choices = np.zeros((states, states)), np.zeros(states), np.full(states, float(actions))
        for action in range(actions):
            np.add.at(follow, (np.arange(states), after[:, action]), 1.0)
            price += 1.0
        for option in paths:
            for state, path in enumerate(option):
                if path:
                    length = path.index(goal) + 1 if goal in path else len(path)
                    follow[state, path[length - 1]] += 1.0
                    price[state] += length
                    choices[state] += 1
        keep = np.arange(states) != goal
        system = np.eye(states - 1) - (follow / choices[:, None])[np.ix_(keep, keep)]
        right = np.column_stack([price / choices, np.ones(states)])[keep]
        totals += np.asarray(np.linalg.solve(system, right)).sum(axis=0)
    primitives, decisions = totals / (states * (states - 1))
    return float(primitives), float(decisions)


def _follow(after: np.ndarray, skill: TableSkill, state: int) -> list[int]:
    """States that an option runs through from a state, in which it may begin, to its end."""
    path: list[int] = []
    while (skill.starts[state] if not path else True) and skill.actions[state] != NOTHING:
        state = int(after[state, skill.actions[state]])
        path.append(state)
    return path


def sample_cover_time(adjacency: Array, rng: np.random.Generator, runs: int) -> float:
    """Mean steps until a simple walk from a random state has met every state."""
    states = len(adjacency)
    neighbours = [np.flatnonzero(row) for row in adjacency]
    total = 0
    for _ in range(runs):
        state = int(rng.integers(states))
        met, left = np.zeros(states, bool), states - 1
        met[state] = True
        while left:
            state = int(neighbours[state][rng.integers(len(neighbours[state]))])
            total += 1
            left -= not met[state]
            met[state] = True
    return total / runs
