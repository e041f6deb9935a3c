"""Rules of the page on generalisation."""

from __future__ import annotations

from typing import Any

from hrl_escape.benchmark.standings import LEAST_HEADROOM
from studies.generalisation.analysis import DEPTHS, FLAT, MEMORY, OBJECTS, SEARCH_BASELINES
from studies.publishing import Rules

STUDIES = ("generalisation", "connected-rooms")


def does_memory_help(numbers: Any) -> bool:
    """With the most training rooms, memory raises the efficiency of the learner over object rows."""
    return numbers.generalisation.gains["memory"].sign > 0


def do_rooms_help_less(numbers: Any) -> bool:
    """More training rooms help, too, and less than memory."""
    gains = numbers.generalisation.gains
    return gains["rooms"].sign > 0 and gains["memory"].low > gains["rooms"].high


def is_there_little_headroom(numbers: Any) -> bool:
    """The Bayes planner is at most 0.04 above the search baseline on each of these sets."""
    found = numbers.generalisation
    return all(found.bayes[rung] - found.search[rung] <= 0.04 for rung in found.search)


def does_the_learner_match_search(numbers: Any) -> bool:
    """With the most rooms, the learner with memory is within 0.05 of the search baseline."""
    found = numbers.generalisation
    return abs(found.means[MEMORY, found.most] - found.search[found.data["shown"]]) <= 0.05


def is_depth_lost_without_memory(numbers: Any) -> bool:
    """In deeper rooms the learner with memory is at most 0.08 below search, and without it few episodes escape."""
    depths = numbers.generalisation.depths
    search = {kind: max(depths[name, kind] for name in SEARCH_BASELINES) for kind in DEPTHS}
    return all(-0.08 <= depths[MEMORY, kind] - search[kind] <= 0.0 and depths[OBJECTS, kind] < 0.02 for kind in DEPTHS)


def do_primitives_fail(numbers: Any) -> bool:
    """The learner over primitives escapes from no unseen room."""
    return numbers.generalisation.means[FLAT, numbers.generalisation.most] == 0


def is_headroom_of_doors_small(numbers: Any) -> bool:
    """In `doors` the Bayes planner is above search, and the gap too small to normalise scores by it."""
    headroom = numbers.connected_rooms.rungs["doors"].headroom
    return 0 < headroom.low <= LEAST_HEADROOM


RULES: Rules = {
    "memory-helps": does_memory_help,
    "memory-before-rooms": lambda n: does_memory_help(n) and do_rooms_help_less(n),
    "little-headroom": is_there_little_headroom,
    "learner-matches-search": does_the_learner_match_search,
    "depth-needs-memory": is_depth_lost_without_memory,
    "primitives-fail": do_primitives_fail,
    "doors-headroom": is_headroom_of_doors_small,
}
