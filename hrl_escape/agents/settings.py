"""Base of all agents' settings, and the SMDP choices that learning agents share.

An agent's settings are a frozen dataclass with a sentence under each field; the command line and the docs are made
from it. See `hrl_escape.settings` for the form.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range, Settings


@dataclasses.dataclass(frozen=True)
class AgentSettings(Settings):
    """Base of agents' settings: impossible values raise `AgentSettingsError`."""

    _error = AgentSettingsError


@dataclasses.dataclass(frozen=True)
class DiscountSettings(AgentSettings):
    """Discount of agents that count time in primitives alone."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k."""


@dataclasses.dataclass(frozen=True)
class LearningSettings(AgentSettings):
    """Discounting of actions of different duration, treatment of truncated episodes, and the clock of schedules."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
