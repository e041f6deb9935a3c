"""How agents look wherever they are drawn: one colour an algorithm, dashes without options, grey for chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hrl_escape.env import looks
from hrl_escape.experiments.grid import AgentSpec

__all__ = ["AgentLook", "choose_looks"]

CHANCE = "#8b8f98"
SPARE = ("#882255", "#999933", "#332288", "#44aa99", "#661100", "#117733")
"""Colours of Tol (2021) for what the six of `looks.LINES` do not suffice for."""


class AgentLook(NamedTuple):
    """Colour of an agent's line, a darker one for its name, and whether the line is dashed."""

    colour: str
    text: str
    is_dashed: bool


def choose_looks(specs: Sequence[AgentSpec]) -> list[AgentLook]:
    """Give the flat and the hierarchical form of one algorithm the same colour, and others another."""
    palette = (*looks.LINES, *SPARE)
    colours: dict[tuple[str, str], str] = {}
    taken: set[tuple[str, bool]] = set()
    found = []
    for spec in specs:
        key = (spec.algorithm, spec.recipe)
        colour = CHANCE if spec.algorithm == "random" else colours.get(key, "")
        if not colour or (colour, spec.chooses_options) in taken:
            used = [*colours.values(), *(look.colour for look in found)]
            colour = min(palette, key=used.count)
            colours.setdefault(key, colour)
        taken.add((colour, spec.chooses_options))
        found.append(AgentLook(colour, _darken(colour), not spec.chooses_options))
    return found


def _darken(colour: str) -> str:
    """Dark enough to be read as text on white."""
    mixed = [round(255 * (0.72 * part + 0.28 * ink)) for part, ink in
             zip(looks.to_rgb(colour), looks.to_rgb(looks.INK), strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)
