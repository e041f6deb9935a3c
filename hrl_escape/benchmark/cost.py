"""Cost of training before it begins: seconds of one core, by the rates of published runs.

`costs.json` holds the seconds that a thousand primitives took each agent, by the number of buttons, as studies measured
them; `python -m benchmarks.ladder costs` writes it. Between these numbers rates are interpolated, beyond them
the nearest holds. Evaluations come on top.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files

import numpy as np

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.grid import Grid
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.names import make_console_text, tell_seconds
from hrl_escape.sets.places import RunPlace
from hrl_escape.sets.room_sequence import list_sets

Rates = Mapping[str, Mapping[int, float]]
"""Seconds of one core for a thousand primitives, by agent and number of buttons."""


@cache
def load_rates() -> Rates:
    """Read the rates in `costs.json`."""
    text = (files("hrl_escape.benchmark") / "costs.json").read_text(encoding="utf-8")
    return {agent: {int(buttons): rate for buttons, rate in known.items()} for agent, known in json.loads(text).items()}


def estimate_rate(agent: str, buttons: float, rates: Rates) -> float | None:
    """Seconds of one core for a thousand primitives; None for an agent without published runs."""
    known = rates.get(agent)
    return None if known is None else float(np.interp(buttons, list(known), list(known.values())))


def count_buttons(config: RoomConfig) -> float:
    """Mean number of targets in rooms of a room configuration, over ten of them."""
    return float(np.mean([sample_puzzle(config, seed)[0].puzzle.count_targets() for seed in range(10)]))


def estimate_hours(agents: Iterable[AgentSpec], primitives: int, buttons: Iterable[float], runs: int, rates: Rates
                   ) -> tuple[float, list[str]]:
    """Core hours of training of the agents that learn and whose rate is known, and the labels of learners without one.

    Each makes so many runs of so many primitives in each place, a room or a set, whose (mean) numbers of buttons are
    given.
    """
    seconds, unknown, places = 0.0, [], list(buttons)
    for agent in agents:
        found = [estimate_rate(agent.name, count, rates) for count in places if agent.learns]
        known = [rate for rate in found if rate is not None]
        seconds += sum(known) * runs * primitives / 1000
        unknown += [agent.label] * (len(known) < len(found))
    return seconds / 3600, unknown


def describe_cost(grid: Grid, places: Iterable[RunPlace]) -> str:
    """Words, for a console, on the time of a core that training in all places of a grid takes."""
    if not any(agent.learns for agent in grid.agents):
        return "nothing learns, so nothing is trained"
    hours, unknown = estimate_hours(grid.agents, grid.primitives, map(_count_at, places), grid.runs, load_rates())
    names = ", ".join(map(make_console_text, unknown))
    return (f"about {tell_seconds(3600 * hours)} of training on one core by published rates"
            + (f", and that of {names}, of which no rate is published" if unknown else ""))


def _count_at(place: RunPlace) -> float:
    if place.split is None:
        return len(place.instance.targets)
    return float(np.mean([count_buttons(rooms.config) for rooms in list_sets(place.split.train)]))
