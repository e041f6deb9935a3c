"""Flat agents and their runs, most of them in many copies of a room at once. Shared by the studies of flat agents."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hrl_escape.agents.registry import get_recipe
from hrl_escape.settings import read_record, replace_settings
from studies.statistics import find_lasting
from studies.study import Study

__all__ = ["FlatLearner", "FlatRun", "TENTHS", "count_untrained", "list_learners"]

TENTHS = 10
ARCHIVE = "archive"
"""Name of the learner that is not an agent."""


@dataclass(frozen=True)
class FlatLearner:
    """A learner over primitives.

    Attributes:
        label: in tables.
        agent: name, or `ARCHIVE`.
        settings: fields to change.
        streams: copies of the room that it learns in at once, compiled; 0 for one ordinary environment.
        repeat: repetitions of each chosen action, in primitives; only with streams.
        budget: primitives, where not the study's.
        sizes: numbers of buttons, where not all of the study's.
    """

    label: str
    agent: str
    settings: dict[str, Any] = field(default_factory=dict)
    streams: int = 64
    repeat: int = 1
    budget: int | None = None
    sizes: tuple[int, ...] | None = None


@dataclass(frozen=True)
class FlatRun:
    """Result of a run.

    Attributes:
        agent: label of the learner.
        buttons: of the room.
        seed: of training; chooses the room where the study has several.
        fewest: primitives of the best known escape.
        budget: primitives; a run that ended early has spent what its last evaluation says.
        first_escape: primitives, of all streams together, at the end of the first training episode that escaped, or
            None without one.
        curve: (primitives, efficiency) of each evaluation of the greedy policy.
        escapes: share of training episodes that escaped, in each tenth of the run, or None if none ended.
        corners: share of the primitives spent in corners, in each tenth; empty of one ordinary environment.
        entropy: of the policy that trains, nats, in each tenth; empty where the agent logs none.
        seconds: of processor time.
        key: hash of everything that decides the numbers.
    """

    agent: str
    buttons: int
    seed: int
    fewest: int
    budget: int
    first_escape: int | None
    curve: tuple[tuple[int, float], ...]
    escapes: tuple[float | None, ...]
    corners: tuple[float, ...]
    entropy: tuple[float, ...]
    seconds: float
    key: str

    @property
    def place(self) -> tuple[str, int, int, int]:
        """Subject of the line."""
        return self.agent, self.buttons, self.seed, self.budget

    @property
    def efficiency(self) -> float:
        """Mean of the evaluations in the last fifth."""
        return float(np.mean([value for at, value in self.curve if at >= 0.8 * self.budget]))

    @property
    def spent(self) -> int:
        """Primitives that it trained for."""
        return self.curve[-1][0]

    def find_threshold(self, least: float) -> int | None:
        """Primitives at the first of two evaluations in a row of at least this efficiency, or None."""
        return find_lasting(self.curve, least)


def count_untrained(learner: FlatLearner) -> int:
    """Most primitives before a learner's first update; 0 of one ordinary environment, where that is soon.

    A decision takes all its repeats until an episode ends, so that first escapes up to here are the untrained policy's.
    """
    recipe: Any = None if learner.agent == ARCHIVE or not learner.streams else get_recipe(learner.agent)
    if not hasattr(recipe, "rollout_per_env"):
        return 0
    settings: Any = replace_settings(recipe, learner.settings)
    return max(settings.rollout, settings.rollout_per_env * learner.streams) * learner.repeat


def list_learners(study: Study) -> list[FlatLearner]:
    """A study's learners, in its order."""
    fields = {field.name for field in dataclasses.fields(FlatLearner)}
    return [read_record(FlatLearner, {name: value for name, value in table.items() if name in fields})
            for table in study.data["learners"]]
