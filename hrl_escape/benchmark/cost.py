"""Estimated cost of training, in seconds of one core, from the rates of published runs.

`costs.json` holds the seconds per thousand primitives of each agent by the number of buttons;
`python -m benchmarks.ladder costs` writes it. Rates are interpolated between these numbers and constant beyond them.
Evaluations are not included.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files

import numpy as np

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.env_spec import EnvPlace
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.references.registry import TRAINED_IN_ROOM, TRAINED_IN_SET
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.names import make_console_text, tell_seconds
from hrl_escape.sets.places import RunPlace
from hrl_escape.sets.room_sequence import list_sets

Rates = Mapping[str, Mapping[int, float]]
"""Seconds of one core per thousand primitives, by agent and number of buttons."""


@cache
def load_rates() -> Rates:
    """Read the rates in `costs.json`."""
    text = (files("hrl_escape.benchmark") / "costs.json").read_text(encoding="utf-8")
    return {agent: {int(buttons): rate for buttons, rate in known.items()} for agent, known in json.loads(text).items()}


def estimate_rate(agent: str, buttons: float, rates: Rates) -> float | None:
    """Return the seconds of one core per thousand primitives, or None for an agent without published runs."""
    known = rates.get(agent)
    return None if known is None else float(np.interp(buttons, list(known), list(known.values())))


def count_buttons(config: RoomConfig) -> float:
    """Return the mean number of targets in ten rooms of a configuration."""
    return float(np.mean([sample_puzzle(config, seed)[0].puzzle.count_targets() for seed in range(10)]))


def estimate_hours(agents: Iterable[AgentSpec], primitives: int, buttons: Iterable[float], runs: int, rates: Rates
                   ) -> tuple[float, list[str]]:
    """Estimate the core hours of training, and return the labels of learners without a known rate.

    Every agent makes the given number of runs, each with the given number of primitives, in each place with the given
    mean number of buttons.
    """
    seconds, unknown, places = 0.0, [], list(buttons)
    for agent in agents:
        found = [estimate_rate(agent.name, count, rates) for count in places if agent.learns]
        known = [rate for rate in found if rate is not None]
        seconds += sum(known) * runs * primitives / 1000
        unknown += [agent.label] * (len(known) < len(found))
    return seconds / 3600, unknown


def describe_cost(grid: Grid, places: Iterable[RunPlace | EnvPlace]) -> str:
    """Describe the estimated core time of a grid for the console."""
    if grid.env is not None:
        return "no rate is published for " + ", ".join(make_console_text(place.name) for place in places)
    references = TRAINED_IN_SET if grid.train_rooms else TRAINED_IN_ROOM
    if not any(agent.learns or agent.name in references for agent in grid.agents):
        return "no agent is trained"
    buttons = [_count_at(place) for place in places if isinstance(place, RunPlace)]
    hours, unknown = estimate_hours(grid.agents, grid.primitives, buttons, grid.runs, load_rates())
    unknown += [agent.label for agent in grid.agents if agent.name in references]
    names = ", ".join(map(make_console_text, unknown))
    return (f"about {tell_seconds(3600 * hours)} of training on one core by published rates"
            + (f", and that of {names}, of which no rate is published" if unknown else ""))


def _count_at(place: RunPlace) -> float:
    if place.split is None:
        return len(place.instance.targets)
    return float(np.mean([count_buttons(rooms.config) for rooms in list_sets(place.split.train)]))
