"""The data inside a report page: curves, profiles, rooms to draw and episodes to replay, as one JSON value.

What reads it is `templates/*.js`. Lengths are metres and angles radians, in the room's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.comparison.comparison import Comparison
from hrl_escape.comparison.reporting.agent_style import AgentStyle, is_level
from hrl_escape.comparison.runs import read_episodes
from hrl_escape.comparison.summary import PROFILE, AgentSummary, Curve, Summary
from hrl_escape.env.drawing.moving_map import PLAYER_COLOURS, describe_room
from hrl_escape.env.instance import RoomInstance

__all__ = ["choose_replays", "make_page_data"]

BEST, MEDIAN = "best", "median"


def make_page_data(summary: Summary, agent_styles: Sequence[AgentStyle], replays: Sequence[dict[str, Any]]
                   ) -> dict[str, Any]:
    """Collect what the page's scripts need."""
    rooms = [describe_room(room.instance) for room in summary.rooms]
    for replay in replays:
        room, primitives = rooms[replay["room"]], _list_primitives(summary.rooms[replay["room"]].instance)
        chosen = {name for name, _, _ in replay["decisions"]} - primitives
        room["options"] = sorted(chosen.union(room["options"]))
    return {
        "agents": [_describe_agent(agent, look) for agent, look in zip(summary.agents, agent_styles, strict=True)],
        "thresholds": PROFILE.tolist(),
        "rooms": rooms,
        "replays": list(replays),
        "looks": PLAYER_COLOURS,
    }


def choose_replays(comparison: Comparison) -> list[dict[str, Any]]:
    """The best and the median of the last evaluation's episodes, of each agent in each room, over all its runs.

    Returns:
        Episodes as `record_episode` gives them, with `agent`, `room` (index), `seed`, `episode` and
        `kinds`: `best`, `median`, or both where they are the same. The median of an even number is the better
        of the two in the middle.
    """
    chosen = []
    for number, spec in enumerate(comparison.grid.agents):
        for room, place in enumerate(comparison.places):
            runs = [run for run, _ in comparison.runs if run.number == number and run.place_id == place.id]
            episodes = [
                {"agent": spec.label, "room": room, "seed": run.seed, "episode": index, **episode}
                for run in runs for index, episode in enumerate(read_episodes(comparison.out, run))
            ]
            if not episodes:
                continue
            episodes.sort(key=lambda episode: -episode["return"])  # stable: equal ones stay in order of seeds
            best, median = episodes[0], episodes[(len(episodes) - 1) // 2]
            if best["return"] == median["return"]:
                chosen.append({**best, "kinds": [BEST, MEDIAN]})
            else:
                chosen += [{**best, "kinds": [BEST]}, {**median, "kinds": [MEDIAN]}]
    return chosen


def _describe_agent(agent: AgentSummary, look: AgentStyle) -> dict[str, Any]:
    return {
        "label": agent.label,
        "colour": look.colour,
        "text": look.text,
        "dash": look.is_dashed,
        "is_level": is_level(agent.spec),
        "curve": _describe_curve(agent.curve),
        "room_curves": [None if curve is None else _describe_curve(curve) for curve in agent.room_curves],
        "profile": _round(agent.profile),
    }


def _describe_curve(curve: Curve) -> dict[str, Any]:
    return {
        "primitives": _round(curve.primitives),
        "decisions": _round(curve.decisions),
        "seconds": _round(curve.seconds),
        **{name: [_round(line) for line in lines] for name, lines in curve.metrics.items()},
    }


def _round(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def _list_primitives(instance: RoomInstance) -> set[str]:
    return set(instance.robot.actions.names)
