"""Study of the decay of SARSA and DDPG with meta-actions: a screening design between two recipes.

Eleven factors an algorithm, each at the level of the recipe `paper` or of `corrected`, none a bundle of ideas that
could be had one by one. Agents and rooms are listed here; `factorial_effects.py` holds effects and tests,
`mediation.py` what the logs carry of them, `factorial_cause.py` the conclusions, `factorial_page.py` the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from hrl_escape.comparison.grid import AgentSpec, Grid, OptionsView
from hrl_escape.comparison.places import RoomSpec
from hrl_escape.comparison.studies.contrasts import make_screening_design
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.presets.catalogue import ladder_room
from hrl_escape.env.puzzles.graphs import GraphConfig

__all__ = ["ALGORITHMS", "FACTORS", "ROOMS", "Factor", "get_factors", "make_factorial_grid", "make_factorial_room",
           "make_label", "name_factorial", "read_levels"]

ALGORITHMS = ("sarsa", "ddpg")
ROOMS = 5


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


_SHARED = (
    Factor("discount", "gamma a decision, plain sum", "gamma^k, discounted sum",
           {"discounting": "decision"}, {"discounting": "primitive"}),
    Factor("truncation", "the cap ends the return", "the state at the cap has a value",
           {"bootstrap_on_truncation": False}, {"bootstrap_on_truncation": True}),
    Factor("choices", "primitives and options", "options only", options_only=True),
    Factor("scaling", "raw observations and rewards", "both scaled",
           {"scale_observations": False, "reward_scale": 1.0}, {"scale_observations": True, "reward_scale": 0.1}),
)
_RATE_WORDS = "step size 1e-3", "step size 3e-4"
_RATE = {"learning_rate": 1e-3, "adam_epsilon": 1e-7}, {"learning_rate": 3e-4, "adam_epsilon": 1e-8}

FACTORS: dict[str, tuple[Factor, ...]] = {
    "sarsa": (
        *_SHARED,
        Factor("exploration", "Boltzmann, temperature 1", "epsilon-greedy",
               {"exploration": "boltzmann", "boltzmann_clip": 500.0}, {"exploration": "epsilon-greedy"}),
        Factor("buffer", "each decision once", "replay of 50,000 decisions",
               {"replay_capacity": 0}, {"replay_capacity": 50_000}),
        Factor("target network", "none", "one, at rate 0.01", {"target_rate": 1.0}, {"target_rate": 0.01}),
        Factor("expectation", "next action drawn", "expected value", {"expected": False}, {"expected": True}),
        Factor("width", "three layers of 32, as Keras draws them", "two layers of 64",
               {"hidden": (32, 32, 32), "initialisation": "glorot"}, {"hidden": (64, 64), "initialisation": "torch"}),
        Factor("loss", "squared, gradients as they are", "Huber, gradients of norm 10 at most",
               {"loss": "squared", "max_grad_norm": 0.0}, {"loss": "huber", "max_grad_norm": 10.0}),
        Factor("learning rate", *_RATE_WORDS, *_RATE),
    ),
    "ddpg": (
        *_SHARED,
        Factor("exploration", "Ornstein-Uhlenbeck noise on the outputs", "epsilon-greedy",
               {"exploration": "ornstein-uhlenbeck"}, {"exploration": "epsilon-greedy"}),
        Factor("coding", "the critic sees the actor's raw outputs",
               "the critic sees the action that ran, one-hot, and the actor what each action is worth",
               {"relaxation": "linear", "entropy_weight": 0.0}, {"relaxation": "one-hot", "entropy_weight": 0.3}),
        Factor("averaging", "the actor of the moment", "the averaged actor",
               {"average_actor": False}, {"average_actor": True}),
        Factor("target rate", "0.001", "0.005", {"target_rate": 0.001}, {"target_rate": 0.005}),
        Factor("width", "three layers of 4, as Keras draws them", "two layers of 64",
               {"hidden": (4, 4, 4), "initialisation": "glorot"}, {"hidden": (64, 64), "initialisation": "torch"}),
        Factor("loss", "squared, gradients of norm 1 at most", "Huber, gradients of norm 10 at most",
               {"loss": "squared", "max_grad_norm": 1.0}, {"loss": "huber", "max_grad_norm": 10.0}),
        Factor("learning rate", _RATE_WORDS[0] + ", 32 decisions an update", _RATE_WORDS[1] + ", 64 decisions",
               _RATE[0] | {"batch_size": 32}, _RATE[1] | {"batch_size": 64}),
    ),
}
"""Algorithm -> its factors. DDPG has replay and target networks in either recipe; its averaged actor is the target
actor, which only the greedy policy follows."""


def get_factors(algorithm: str) -> list[str]:
    """Names of an algorithm's factors."""
    return [factor.name for factor in FACTORS[algorithm]]


def make_factorial_room() -> RoomConfig:
    """Rooms of the study: three buttons in a chain whose numbers say nothing of their order, 12 x 12 m."""
    return ladder_room("three-button-chain", 3, GraphConfig(kind="chain"), 12.0, horizon=300)


def name_factorial(algorithm: str, is_fresh: bool = False) -> str:
    """Name of an algorithm's grid and of its raw results: of the study, or of runs that were kept for the end."""
    return f"factorial-{algorithm}{'-fresh' if is_fresh else ''}"


def make_factorial_grid(algorithm: str, rooms: int = ROOMS, runs: int = 5, primitives: int = 4_000,
                        first: int = 0) -> Grid:
    """An algorithm's 24 agents in rooms drawn from one schematic.

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
        rooms=tuple(RoomSpec(config=config, seed=number) for number in range(first, first + rooms)),
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
    """Levels that an agent's label tells: -1 the paper's, 1 the corrected."""
    return [1 if letter == "1" else -1 for letter in label.rpartition("-")[2]]
