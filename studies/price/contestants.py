"""Rooms and learners of the study `price`, read from `study.toml`.

A replicate is a room of each size and a training seed, the same for all learners.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from typing import Any

from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.files import read_toml
from hrl_escape.settings import read_record

__all__ = ["BUTTON_COUNTS", "CONTESTANTS", "EFFICIENT", "FRESH", "PAIRS", "VARIANTS", "Contestant", "make_chain_room",
           "sample_replicate_room"]

_DATA = read_toml(Path(__file__).with_name("study.toml"))
BUTTON_COUNTS: tuple[int, ...] = tuple(_DATA["sizes"])
EFFICIENT: float = _DATA["efficient"]
PAIRS: dict[str, str] = _DATA["pairs"]
VARIANTS: dict[str, str] = _DATA["variants"]
FRESH = 200
"""First replicate of a fresh series, whose caps count from there."""


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
    """Room of a replicate: so many instances of the room configuration come before it, the unfit ones not counted."""
    fit = (seed for seed in count() if seed not in _DATA["unfit"].get(str(buttons), ()))
    return generate(make_chain_room(buttons), next(islice(fit, replicate, None)))


@dataclass(frozen=True)
class Contestant:
    """A learner, and for how long it may learn.

    Attributes:
        label: in tables.
        agent: name; with the prefix `smdp-` it chooses among the presses of a planner, and nothing else.
        budget: primitives of a run.
        eval_every: primitives between evaluations.
        sizes: numbers of buttons.
        settings: fields to change.
        streams: copies of the room that it learns in at once, compiled; 0 for one ordinary environment.
        replicates: the first so many of a series.
        stage: runs of a later stage begin when earlier stages are done.
    """

    label: str
    agent: str
    budget: int
    eval_every: int
    sizes: tuple[int, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    streams: int = 0
    replicates: int = 10
    stage: int = 0

    @property
    def has_options(self) -> bool:
        """It chooses among presses."""
        return self.agent.startswith("smdp-")

    @property
    def has_goals(self) -> bool:
        """It is asked for the exit as one goal among others, and learns in hindsight."""
        return "hindsight_goals" in self.settings


CONTESTANTS = tuple(read_record(Contestant, learner) for learner in _DATA["learners"])
