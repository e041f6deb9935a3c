"""Style of agents in all figures: one colour an algorithm, dashes without options, grey for what learns nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.env.drawing import palette

GREYS = ("#8b8f98", "#5a5e67", "#b3b7bd")
"""Greys, for agents that learn nothing."""
SPARE = ("#882255", "#999933", "#332288", "#44aa99", "#661100", "#117733")
"""Colours of Tol (2021) for what the six of `palette.LINES` do not suffice for."""


class AgentStyle(NamedTuple):
    """Colour of an agent's line, a darker one for its name, and whether the line is dashed."""

    colour: str
    text: str
    is_dashed: bool


def choose_styles(specs: Sequence[AgentSpec]) -> list[AgentStyle]:
    """Give the flat and the hierarchical form of one algorithm the same colour, and others another."""
    colours: dict[tuple[str, str], str] = {}
    found: list[AgentStyle] = []
    for spec in specs:
        key, is_dashed = (spec.algorithm, spec.recipe), not spec.chooses_options
        colour = colours.get(key, "")
        if not colour or (colour, is_dashed) in [(look.colour, look.is_dashed) for look in found]:
            used = [*colours.values(), *(look.colour for look in found)]
            colour = min(GREYS if not spec.learns else (*palette.LINES, *SPARE), key=used.count)
            colours.setdefault(key, colour)
        found.append(AgentStyle(colour, _darken(colour), is_dashed))
    return found


def is_level(spec: AgentSpec) -> bool:
    """Return whether an agent's curve is a level: it learns nothing, and is drawn as a thin line without a band."""
    return spec.is_reference or not spec.learns


def _darken(colour: str) -> str:
    """Dark enough to be read as text on white."""
    mixed = [round(255 * (0.72 * part + 0.28 * ink)) for part, ink in
             zip(palette.to_rgb(colour), palette.to_rgb(palette.INK), strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)
