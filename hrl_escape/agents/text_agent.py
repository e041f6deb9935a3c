"""Settings of the agent `text-agent`, and the levels of revealed information; light, for users of the names alone."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias, get_args

from hrl_escape.agents.agent import DiscountSettings

TEXT_AGENT = "text-agent"
"""Name of the agent that calls tools."""
Level: TypeAlias = Literal["names", "places", "model"]
"""Level of what a text reveals: the names of options and objects and what is lit; where they are as well; and the
puzzle's symbolic model, which no other agent sees."""
REVEAL_LEVELS: tuple[Level, ...] = get_args(Level)


@dataclasses.dataclass(frozen=True)
class TextAgentSettings(DiscountSettings):
    """Settings of the agent `text-agent`."""

    _section = "TextAgentSettings"
    model: str = "search-nearest"
    """Caller: a scripted manager (random, search-random, search-nearest, oracle), a file of recorded games (.jsonl), or
    a model of another package."""
    reveal: Level = "places"
    """Names of things and what is lit (names), where they are too (places), or the symbolic model as well (model)."""
