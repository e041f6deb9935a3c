"""Screening design of the decay of SARSA and DDPG with meta-actions, between two recipes; `study.toml` has its factors.

Designs of Plackett and Burman have up to 11 two-level factors in 12 rows, folded over into 24 (Plackett and
Burman 1946; Montgomery, Design and Analysis of Experiments, section 8.6). Main effects are then free of interactions of
two factors (resolution IV), which are mixed with each other only. Any three factors take all eight combinations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.grid import Grid
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.presets import ladder_room
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.files import read_toml
from hrl_escape.sets.room_spec import RoomSpec
from hrl_escape.settings import read_record

__all__ = ["ALGORITHMS", "FACTORS", "MOST_FACTORS", "Factor", "get_factors", "make_factorial_grid",
           "make_factorial_room", "make_label", "make_screening_design", "name_factorial", "read_levels"]

ALGORITHMS = ("sarsa", "ddpg")
MOST_FACTORS = 11
_GENERATOR = (1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1)
"""First row of the design in 12 rows; the next ten are its rotations, the last is all low."""


@dataclass(frozen=True)
class Factor:
    """One difference between the recipes.

    Attributes:
        name: one or two words.
        paper: what the published program did, in words.
        corrected: what we recommend, in words.
        low: settings at the paper's level.
        high: settings at the corrected level.
        options_only: at the corrected level only options are choices.
    """

    name: str
    paper: str
    corrected: str
    low: dict[str, Any] = field(default_factory=dict)
    high: dict[str, Any] = field(default_factory=dict)
    options_only: bool = False


_TABLES = read_toml(Path(__file__).with_name("study.toml"))["factors"]
FACTORS: dict[str, tuple[Factor, ...]] = {
    name: tuple(read_record(Factor, table) for table in (*_TABLES["shared"], *_TABLES[name])) for name in ALGORITHMS}
"""Algorithm -> its factors."""


def make_screening_design(factors: int) -> NDArray[np.int64]:
    """Levels of the folded-over design of Plackett and Burman; the first row is all low, the last all high.

    Args:
        factors: k, at most `MOST_FACTORS`.

    Returns:
        (24, k) of -1 and 1; row 23 - i is row i with all signs turned.
    """
    if not 1 <= factors <= MOST_FACTORS:
        raise ValueError(f"{factors} factors do not fit: 1 to {MOST_FACTORS} do")
    half = np.array([[-1] * MOST_FACTORS, *(np.roll(_GENERATOR, shift) for shift in range(MOST_FACTORS))],
                    dtype=np.int64)[:, :factors]
    return np.concatenate([half, -half[::-1]])


def get_factors(algorithm: str) -> list[str]:
    """Names of an algorithm's factors."""
    return [factor.name for factor in FACTORS[algorithm]]


def make_factorial_room() -> RoomConfig:
    """Rooms of the study: three buttons in a chain whose numbers say nothing of their order, 12 x 12 m."""
    return ladder_room("three-button-chain", 3, GraphConfig(kind="chain"), 12.0, horizon=300)


def name_factorial(algorithm: str, is_fresh: bool = False) -> str:
    """Name of an algorithm's grid and of its raw results: of the study, or of runs that were kept for the end."""
    return f"factorial-{algorithm}{'-fresh' if is_fresh else ''}"


def make_factorial_grid(algorithm: str, rooms: int = 5, runs: int = 5, primitives: int = 4_000, first: int = 0) -> Grid:
    """An algorithm's 24 agents in rooms drawn from one room configuration.

    Args:
        algorithm: one of `ALGORITHMS`.
        rooms: number of rooms, instances of `make_factorial_room`.
        runs: training seeds.
        primitives: budget of a run; epsilon falls over three quarters of it, where the recipe takes 5,000.
        first: lowest instance and lowest training seed.
    """
    config = make_factorial_room().to_dict()
    schedule = {"epsilon_steps": max(1, 3 * primitives // 4)}
    return Grid(
        name=name_factorial(algorithm, first > 0),
        description=f"What makes {algorithm} worsen with meta-actions: eleven factors at two levels.",
        agents=tuple(_make_agent(algorithm, row, schedule)
                     for row in make_screening_design(len(FACTORS[algorithm])).tolist()),
        rooms=tuple(RoomSpec(config=config, instance=number) for number in range(first, first + rooms)),
        runs=runs,
        first_seed=first,
        primitives=primitives,
        eval_every=primitives,  # the response is read off training episodes
        eval_episodes=1,
    )


def _make_agent(algorithm: str, levels: Sequence[int], schedule: dict[str, Any]) -> AgentSpec:
    settings = dict(schedule)
    options_only = False
    for factor, level in zip(FACTORS[algorithm], levels, strict=True):
        settings |= factor.high if level > 0 else factor.low
        options_only |= factor.options_only and level > 0
    return AgentSpec(f"smdp-{algorithm}", make_label(algorithm, levels), settings=settings,
                     options=OptionsView(include_primitives=not options_only))


def make_label(algorithm: str, levels: Sequence[int]) -> str:
    """Label of the agent with these levels, a digit a factor."""
    return f"{algorithm}-" + "".join("1" if level > 0 else "0" for level in levels)


def read_levels(label: str) -> list[int]:
    """Levels in an agent's label: -1 the paper's, 1 the corrected."""
    return [1 if letter == "1" else -1 for letter in label.rpartition("-")[2]]
