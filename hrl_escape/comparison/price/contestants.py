"""Rooms and learners of the price of flatness.

A replicate is a room of each size and a training seed, the same for all learners. Settings that differ from the
defaults were tried in other rooms; `trials.toml` tells in which, and how often.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count, islice
from types import MappingProxyType
from typing import Any

from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate

__all__ = ["BUTTON_COUNTS", "CONTESTANTS", "EFFICIENT", "FRESH", "PAIRS", "VARIANTS", "Contestant", "make_chain_room",
           "sample_replicate_room"]

BUTTON_COUNTS = (1, 2, 3, 4, 6)
"""Numbers of buttons."""
EFFICIENT = 0.9
"""Efficiency of a greedy policy from which on it counts as efficient, in two evaluations in a row."""
FRESH = 200
"""First replicate of a fresh series, whose caps count from there."""

_UNFIT: Mapping[int, tuple[int, ...]] = MappingProxyType({4: (0, 4, 8)})
"""Number of buttons -> first instances in which not even the best order of presses is efficient: they are left out."""


def make_chain_room(buttons: int) -> RoomConfig:
    """A room of 20 x 20 m with buttons of 4 m anywhere on its walls, each before the next, and an exit of 4 m."""
    return RoomConfig(
        name=f"chain-{buttons}",
        room=ShapeConfig(width=20, depth=20),
        robot=RobotConfig(body_radius=0.75),
        puzzle=ButtonsConfig(count=buttons, graph=GraphConfig(kind="chain"), buttons=Panels(width=4.0)),
        start=StartConfig(place="fixed"),
        exit=ExitConfig(width=4.0, depth=4.0),
    )


def sample_replicate_room(buttons: int, replicate: int) -> RoomInstance:
    """Room of a replicate: so many instances of the schematic come before it, the unfit ones not counted."""
    fit = (seed for seed in count() if seed not in _UNFIT.get(buttons, ()))
    return generate(make_chain_room(buttons), next(islice(fit, replicate, None)))


@dataclass(frozen=True)
class Contestant:
    """A learner, and for how long it may learn.

    Attributes:
        label: in tables.
        agent: name; with the prefix `smdp-` it chooses among the presses of a planner, and nothing else.
        budget: primitives of a run.
        eval_every: primitives between evaluations.
        settings: fields to change.
        streams: copies of the room that it learns in at once, compiled; 0 for one ordinary environment.
        replicates: the first so many of a series.
        stage: runs of a later stage are begun when those of earlier ones are done.
        sizes: numbers of buttons.
    """

    label: str
    agent: str
    budget: int
    eval_every: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    streams: int = 0
    replicates: int = 10
    stage: int = 0
    sizes: tuple[int, ...] = BUTTON_COUNTS

    @property
    def has_options(self) -> bool:
        """It chooses among presses."""
        return self.agent.startswith("smdp-")

    @property
    def has_goals(self) -> bool:
        """It is asked for the exit as one goal among others, and learns in hindsight."""
        return "hindsight_goals" in self.settings


_PATIENT: dict[str, Any] = {"learning_rate": 1e-3, "epsilon_end": 0.1, "epsilon_steps": 30_000,
                            "replay_capacity": 100_000}
_COUNTS: dict[str, Any] = {"bins": 21, "learning_rate": 0.3, "bonus_weight": 2.0, "bonus_bins": 11}
_LOOSE: dict[str, Any] = {"learning_rate": 3e-4, "epochs": 4, "reward_scale": 0.01, "entropy_weight": 0.1}
_SHORT: dict[str, Any] = {"rollout": 32, "batch_size": 32}  # a run over options has some hundred decisions
_NOVEL: dict[str, Any] = _PATIENT | {"bonus": "distillation", "bonus_weight": 1.0}
_HINDSIGHT: dict[str, Any] = _PATIENT | {"hindsight_goals": 4, "n_step": 1, "replay_capacity": 500_000}

CONTESTANTS = (
    Contestant("options, dqn", "smdp-dqn", 20_000, 250, sizes=(1, 2, 3, 4)),
    Contestant("options, dqn", "smdp-dqn", 40_000, 500, sizes=(6,)),
    Contestant("options, ppo", "smdp-ppo", 20_000, 250, _SHORT, stage=1, sizes=(1, 2, 3, 4)),
    Contestant("options, ppo", "smdp-ppo", 40_000, 500, _SHORT, stage=1, sizes=(6,)),
    Contestant("options, q-learning", "smdp-q-learning", 20_000, 250, stage=1, sizes=(1, 2, 3)),
    Contestant("random", "random", 100_000, 100_000, sizes=(1, 2)),
    Contestant("dqn, defaults", "dqn", 20_000, 5_000, sizes=(1,)),
    Contestant("dqn", "dqn", 1_000_000, 2_500, _PATIENT, stage=2, sizes=(1, 2, 3)),
    Contestant("dqn", "dqn", 60_000, 2_500, _PATIENT, sizes=(4, 6)),
    Contestant("dqn, distillation", "dqn", 100_000, 2_500, _NOVEL, sizes=(1,)),
    Contestant("dqn, hindsight", "dqn", 100_000, 2_500, _HINDSIGHT, sizes=(1,)),
    Contestant("dqn, hindsight", "dqn", 60_000, 2_500, _HINDSIGHT, sizes=(2, 3)),
    Contestant("q-learning, counts", "q-learning", 100_000, 5_000, _COUNTS, stage=1, sizes=(1, 2, 3)),
    Contestant("ppo", "ppo", 1_000_000, 50_000, _LOOSE, streams=256, replicates=4, stage=1),
    Contestant("ppo, long", "ppo", 10_000_000, 250_000, _LOOSE, streams=256, stage=2, sizes=(1,)),
    Contestant("ppo, long", "ppo", 10_000_000, 250_000, _LOOSE, streams=256, replicates=1, stage=2, sizes=(2,)),
)
"""All learners, those over options first; one with different budgets in small and large rooms is two."""

PAIRS = {"dqn": "options, dqn", "q-learning, counts": "options, q-learning", "ppo, long": "options, ppo"}
"""Learner over primitives -> the same over options. The first pair is the one of the headline: the learner that did
best in the rooms in which settings were tried."""
VARIANTS: Mapping[str, str] = MappingProxyType({
    "dqn, distillation": "explores by random network distillation (`bonus`)",
    "dqn, hindsight": "is asked for the exit as one goal among patterns of lit buttons, and learns from each episode "
                      "as if patterns had been asked for that it achieved (`hindsight_goals`); none is asked for in "
                      "fact, for the learner has to find out which of them lead on",
})
"""Other ways to learn of the headline's learner over primitives -> what each does, in words."""
