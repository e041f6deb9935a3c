"""The task graph of Taxi for learners: Dietterich's, with his state abstraction and without."""

from __future__ import annotations

from hrl_escape.agents.hierarchy.task import Hierarchy
from hrl_escape.agents.hierarchy.task_graph import maxq
from tests.classic.taxi import DEPOTS, EAST, NORTH, PICK_UP, PUT_DOWN, SOUTH, WEST, decode

GRAPH = {
    "root": ["get", "put"],
    "get": [PICK_UP, *(f"navigate {depot}" for depot in range(4))],
    "put": [PUT_DOWN, *(f"navigate {depot}" for depot in range(4))],
} | {f"navigate {depot}": [SOUTH, NORTH, EAST, WEST] for depot in range(4)}


def is_at(depot):
    return lambda seen: (seen.state.row, seen.state.column) == DEPOTS[depot]


UNTIL = {
    "get": lambda seen: seen.state.riding,
    "put": lambda seen: not seen.state.riding,
} | {f"navigate {depot}": is_at(depot) for depot in range(4)}


def see_nothing(seen):
    return 0


def see_cell(seen):
    return seen.state.row, seen.state.column


def is_pick_up_legal(seen):
    return not seen.state.riding and (seen.state.row, seen.state.column) == DEPOTS[seen.state.passenger]


def is_put_down_legal(seen):
    return seen.state.riding and (seen.state.row, seen.state.column) == DEPOTS[seen.state.destination]


SEE = {
    ("root", "get"): lambda seen: (seen.state.passenger, seen.state.destination),
    ("root", "put"): see_nothing,
    ("get", PICK_UP): is_pick_up_legal,
    ("put", PUT_DOWN): is_put_down_legal,
    PICK_UP: is_pick_up_legal,
    PUT_DOWN: is_put_down_legal,
    **{direction: see_nothing for direction in (SOUTH, NORTH, EAST, WEST)},
    **{("get", f"navigate {depot}"): lambda seen: seen.state.passenger for depot in range(4)},
    # A passenger who was just picked up may still change his mind.
    **{("put", f"navigate {depot}"): lambda seen: (seen.state.passenger, seen.state.destination) for depot in range(4)},
    **{f"navigate {depot}": see_cell for depot in range(4)},
}
"""Undiscounted only: the completions of `get` and `put` do not depend on how long a child took."""


def make_taxi_tasks(abstract: bool = True, **arguments) -> Hierarchy:
    return maxq(GRAPH, UNTIL, SEE if abstract else {}, read=lambda observation: decode(int(observation)), **arguments)
