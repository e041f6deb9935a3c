"""How agents look wherever they are drawn: one colour an algorithm, dashes without options, grey for chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hrl_escape.env import looks
from hrl_escape.experiments.grid import AgentSpec

__all__ = ["AgentLook", "choose_looks"]

CHANCE = ("#8b8f98", "#5a5e67", "#b3b7bd")
"""Greys, for agents that choose at random."""
SPARE = ("#882255", "#999933", "#332288", "#44aa99", "#661100", "#117733")
"""Colours of Tol (2021) for what the six of `looks.LINES` do not suffice for."""


class AgentLook(NamedTuple):
    """Colour of an agent's line, a darker one for its name, and whether the line is dashed."""

    colour: str
    text: str
    is_dashed: bool


def choose_looks(specs: Sequence[AgentSpec]) -> list[AgentLook]:
    """Give the flat and the hierarchical form of one algorithm the same colour, and others another."""
    colours: dict[tuple[str, str], str] = {}
    found: list[AgentLook] = []
    for spec in specs:
        key, is_dashed = (spec.algorithm, spec.recipe), not spec.chooses_options
        colour = colours.get(key, "")
        if not colour or (colour, is_dashed) in [(look.colour, look.is_dashed) for look in found]:
            used = [*colours.values(), *(look.colour for look in found)]
            colour = min(CHANCE if spec.algorithm == "random" else (*looks.LINES, *SPARE), key=used.count)
            colours.setdefault(key, colour)
        found.append(AgentLook(colour, _darken(colour), is_dashed))
    return found


def _darken(colour: str) -> str:
    """Dark enough to be read as text on white."""
    mixed = [round(255 * (0.72 * part + 0.28 * ink)) for part, ink in
             zip(looks.to_rgb(colour), looks.to_rgb(looks.INK), strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)
