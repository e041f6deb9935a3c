"""Study of the decay of SARSA and DDPG with meta-actions: a two-level factorial between two recipes.

Six factors, each at the level of the recipe `paper` or of `corrected`. A half fraction of resolution VI, 32 agents an
algorithm, is analysed; 12 more differ from either recipe in one factor alone. Agents and rooms are listed here;
`contrasts.py` holds the analysis, `factorial_page.py` the page.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.experiments.grid import AgentSpec, Grid, OptionsView
from hrl_escape.experiments.places import RoomSpec
from hrl_escape.experiments.statistics import compute_final, compute_slope
from hrl_escape.experiments.studies.contrasts import Analysis, analyse, make_half_fraction
from hrl_escape.experiments.studies.raw import RawRun

__all__ = ["ALGORITHMS", "CONTROLS", "FACTORS", "RESPONSES", "Factor", "analyse_runs", "get_factors", "make_corners",
           "make_factorial_grid", "name_control", "read_levels"]

ALGORITHMS = ("sarsa", "ddpg")
ROOMS = ("paper-two-button", "larg-2019", "four-button-chain")
RESPONSES = ("final score", "slope")


@dataclass(frozen=True)
class Factor:
    """One difference between the recipes.

    Attributes:
        name: one word.
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


_SHARED = (
    Factor("discount", "gamma a decision, plain sum", "gamma^k, discounted sum",
           {"discounting": "decision"}, {"discounting": "primitive"}),
    Factor("truncation", "the cap ends the return", "the state at the cap has a value",
           {"bootstrap_on_truncation": False}, {"bootstrap_on_truncation": True}),
)
_CHOICES = Factor("choices", "primitives and options", "options only", options_only=True)
_NUMERICS_LOW = {"initialisation": "glorot", "adam_epsilon": 1e-7, "scale_observations": False, "reward_scale": 1.0,
                 "loss": "squared"}
_NUMERICS_WORDS = ("raw observations and rewards, squared loss, the program's layers",
                   "scaled observations and rewards, Huber loss, two layers of 64")

FACTORS: dict[str, tuple[Factor, ...]] = {
    "sarsa": (
        *_SHARED,
        Factor("exploration", "Boltzmann, temperature 1", "epsilon-greedy",
               {"exploration": "boltzmann", "boltzmann_clip": 500.0}, {"exploration": "epsilon-greedy"}),
        Factor("replay", "each decision once, no target network", "replay, target network, expected value",
               {"replay_capacity": 0, "target_rate": 1.0, "expected": False},
               {"replay_capacity": 50_000, "target_rate": 0.01, "expected": True}),
        _CHOICES,
        Factor("numerics", *_NUMERICS_WORDS,
               _NUMERICS_LOW | {"hidden": (32, 32, 32), "learning_rate": 1e-3, "max_grad_norm": 0.0}),
    ),
    "ddpg": (
        *_SHARED,
        Factor("exploration", "Ornstein-Uhlenbeck noise on the outputs", "epsilon-greedy",
               {"exploration": "ornstein-uhlenbeck"}, {"exploration": "epsilon-greedy"}),
        Factor("coding", "the critic sees the actor's raw outputs",
               "the critic sees the action that ran, one-hot, and the actor what each action is worth",
               {"relaxation": "linear", "entropy_weight": 0.0}, {"relaxation": "one-hot", "entropy_weight": 0.3}),
        _CHOICES,
        Factor("numerics", _NUMERICS_WORDS[0] + " and target rate, the actor of the moment",
               _NUMERICS_WORDS[1] + ", the averaged actor",
               _NUMERICS_LOW | {"hidden": (4, 4, 4), "learning_rate": 1e-3, "max_grad_norm": 1.0, "target_rate": 0.001,
                                "batch_size": 32, "average_actor": False}),
    ),
}
"""Algorithm -> its six factors. DDPG has replay and target networks in either recipe; in their place stands how the
critic sees actions."""


CONTROLS: dict[str, dict[str, dict[str, Any]]] = {
    "sarsa": {"temperature 10": {"temperature": 10.0}, "temperature 100": {"temperature": 100.0}},
    "ddpg": {},
}
"""Algorithm -> name of a control -> what it changes in the published program's settings."""


def get_factors(algorithm: str) -> list[str]:
    """Names of an algorithm's factors."""
    return [factor.name for factor in FACTORS[algorithm]]


def make_factorial_grid(algorithm: str, corners: bool = True, runs: int = 1, primitives: int = 20_000) -> Grid:
    """An algorithm's agents in three rooms.

    Args:
        algorithm: one of `ALGORITHMS`.
        corners: with the controls and the agents that differ from a recipe in one factor, besides the half fraction.
        runs: training seeds.
        primitives: budget of a run.
    """
    factors = len(FACTORS[algorithm])
    agents = [_make_agent(algorithm, row) for row in make_half_fraction(factors)]
    if corners:
        agents += [_make_agent(algorithm, row) for row in make_corners(factors)]
        published = agents[0]
        agents += [dataclasses.replace(published, label=name_control(algorithm, name),
                                       settings=published.settings | changes)
                   for name, changes in CONTROLS[algorithm].items()]
    return Grid(
        name=f"factorial-{algorithm}",
        description=f"What makes {algorithm} worsen with meta-actions: six factors at two levels.",
        agents=tuple(agents),
        rooms=tuple(map(RoomSpec.parse, ROOMS)),
        runs=runs,
        primitives=primitives,
        eval_every=max(1, primitives // 20),
        eval_episodes=1,  # these rooms have one start, so all episodes of an evaluation are the same
    )


def make_corners(factors: int) -> NDArray[np.int64]:
    """Levels with one factor high and all others low, then with one low and all others high: (2k, k)."""
    alone = 2 * np.eye(factors, dtype=np.int64) - 1
    return np.concatenate([alone, -alone])


def _make_agent(algorithm: str, levels: Sequence[int]) -> AgentSpec:
    settings: dict[str, Any] = {}
    options_only = False
    for factor, level in zip(FACTORS[algorithm], levels, strict=True):
        settings |= factor.high if level > 0 else factor.low
        options_only |= factor.options_only and level > 0
    label = f"{algorithm}-" + "".join("1" if level > 0 else "0" for level in levels)
    return AgentSpec(f"smdp-{algorithm}", label, settings=settings,
                     options=OptionsView(include_primitives=not options_only))


def name_control(algorithm: str, name: str) -> str:
    """The label of a control."""
    return f"{algorithm}, {name}"


def read_levels(label: str) -> list[int]:
    """The levels that an agent's label tells: -1 the paper's, 1 the corrected; none for a control."""
    return [] if "," in label else [1 if letter == "1" else -1 for letter in label.rpartition("-")[2]]


def compute_response(run: RawRun, response: str) -> float:
    """`final score`: of frozen weights in the last fifth. `slope`: of the score of training episodes, a whole run."""
    if response == "final score":
        return compute_final(run.at, run.scores, run.budget)
    return run.budget * compute_slope(run.training_at, run.training_scores, 0, run.budget)


def analyse_runs(algorithm: str, runs: Sequence[RawRun], response: str) -> Analysis:
    """Analysis of variance of the half fraction, rooms as blocks.

    Raises:
        ComparisonError: runs are missing.
    """
    fraction = {tuple(row) for row in make_half_fraction(len(FACTORS[algorithm])).tolist()}
    runs = [run for run in runs if tuple(read_levels(run.agent)) in fraction]
    levels: NDArray[np.int64] = np.array([read_levels(run.agent) for run in runs])
    values = [compute_response(run, response) for run in runs]
    return analyse(get_factors(algorithm), levels, [run.room for run in runs], values)
