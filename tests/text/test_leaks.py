"""What is said before the first press tells nothing of the hidden order; a leak would be seen.

Exactly: the same room is told with every hidden order in turn, so the mutual information between text and order, given
the room, is a sum over counts. As rooms are generated: between what is told of a button and its rank in that order.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
import pytest

import hrl_escape.text.text_env as text_env
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.graphs import find_ancestors
from hrl_escape.sets import find_set
from hrl_escape.text import RoomSession

THING = re.compile(r'"button-(\d+)"(?: at \((-?[\d.]+), (-?[\d.]+)\))?, off')


def list_rooms(rung: str, count: int) -> list[RoomInstance]:
    return list(find_set(f"ladder-1/{rung}/train#0..{count}"))


def say_before_the_first_press(room: RoomInstance, reveal: Any) -> str:
    """The first text, tools, a look, a wrong call and a move: all that can be had without a press."""
    env = EscapeRoomEnv(instance=room)
    session = RoomSession(env, reveal)
    said = [session.reset(seed=0), repr(session.tools()), session.call("look").text, session.call("fly").text,
            session.call("move", {"primitive": "turn-left"}).text, session.call("run_option", {"option": "x"}).text]
    env.close()
    return "\n".join(said)


def with_every_order(room: RoomInstance) -> dict[tuple[int, ...], RoomInstance]:
    """The room with its chain of buttons in every order."""
    made = {}
    for order in itertools.permutations(range(len(room.targets))):
        puzzle: Any = dataclasses.replace(room.puzzle, edge_list=tuple(itertools.pairwise(order)), goal=order[-1])
        made[order] = dataclasses.replace(room, puzzle=puzzle)
    return made


def compute_information(pairs: Sequence[tuple[Hashable, Hashable]]) -> float:
    """Mutual information of two values by their counts, bits."""
    both, ones, others = Counter(pairs), Counter(one for one, _ in pairs), Counter(other for _, other in pairs)
    total = len(pairs)
    return sum(n / total * math.log2(n * total / (ones[one] * others[other])) for (one, other), n in both.items())


def measure_information(rooms: Sequence[RoomInstance], reveal: Any) -> float:
    """Information between text and order given the room, the mean over rooms, bits."""
    return float(np.mean([compute_information([(say_before_the_first_press(each, reveal), order)
                                               for order, each in with_every_order(room).items()]) for room in rooms]))


def test_information_is_that_of_known_tables():
    assert compute_information([(0, "a"), (1, "b")] * 5) == 1.0
    assert compute_information([(0, "a"), (0, "b"), (1, "a"), (1, "b")]) == 0.0
    assert compute_information([(0, 0)] * 3 + [(1, 1)]) == pytest.approx(-0.75 * math.log2(0.75) + 0.5)


@pytest.mark.parametrize("reveal", ["names", "places"])
def test_what_is_said_holds_no_information_on_the_order(reveal: str):
    assert measure_information(list_rooms("pair", 20), reveal) == 0.0
    assert measure_information(list_rooms("chain-3", 4), reveal) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("reveal", ["names", "places"])
def test_it_holds_none_in_400_rooms(reveal: str):
    assert measure_information(list_rooms("pair", 400), reveal) == 0.0


def test_the_symbolic_model_tells_all_of_it_as_it_declares():
    assert measure_information(list_rooms("pair", 3), "model") == 1.0
    assert measure_information(list_rooms("chain-3", 1), "model") == pytest.approx(math.log2(6))


def by_order(describe: Callable[..., str]) -> Callable[..., str]:
    def listed(instance: Any, *rest: Any) -> str:
        order = [instance.puzzle.edges[0][0], *(child for _, child in instance.puzzle.edges)]
        before, here, after = describe(instance, *rest).partition("Here are ")
        things = after.rstrip(".").split("; ")
        return before + here + "; ".join(things[button] for button in order)
    return listed


def with_index(describe: Callable[..., str]) -> Callable[..., str]:
    def numbered(instance: Any, *rest: Any) -> str:
        return f"{describe(instance, *rest)}\nGoal {instance.puzzle.goal}."
    return numbered


@pytest.mark.parametrize("leak", [by_order, with_index], ids=["order of listing", "index"])
def test_a_planted_leak_is_seen(leak: Callable[..., Any], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(text_env, "tell_room", leak(text_env.tell_room))
    assert measure_information(list_rooms("pair", 3), "places") == 1.0
    assert measure_information(list_rooms("chain-3", 1), "names") > 1.0


# --- as rooms are generated -----------------------------------------------------------------


def list_features(room: RoomInstance, text: str) -> dict[str, list[Hashable]]:
    """For each button as it is listed: its place in the list, its number, its wall, and how near it is."""
    found = THING.findall(text)[:len(room.targets)]
    here = next((float(x), float(y)) for x, y in re.findall(r"You are at \((-?[\d.]+), (-?[\d.]+)\)", text))
    away = [math.dist(here, (float(x), float(y))) for _, x, y in found]
    return {"listed": list(range(len(found))), "number": [int(number) for number, *_ in found],
            "wall": [(abs(float(x)) > abs(float(y)), float(x) > 0, float(y) > 0) for _, x, y in found],
            "near": np.argsort(np.argsort(away)).tolist()}


def measure_features(rooms: Sequence[RoomInstance]) -> dict[str, tuple[float, float]]:
    """Information between each feature and the rank in the hidden order, and what chance hardly gives, bits."""
    pairs: dict[str, list[tuple[Hashable, int]]] = {}
    for room in rooms:
        env = EscapeRoomEnv(instance=room)
        text = RoomSession(env).reset(seed=0)
        env.close()
        puzzle: Any = room.puzzle
        rank = [len(find_ancestors(puzzle.edges, (button,))) for button in range(len(room.targets))]
        ranks = [rank[int(number) - 1] for number, *_ in THING.findall(text)[:len(room.targets)]]
        for name, values in list_features(room, text).items():
            pairs.setdefault(name, []).extend(zip(values, ranks, strict=True))
    rng, found = np.random.default_rng(0), {}
    for name, own in pairs.items():
        values, ranks = [value for value, _ in own], np.array([rank for _, rank in own]).reshape(len(rooms), -1)
        chance = [compute_information(list(zip(values, rng.permuted(ranks, axis=1).ravel().tolist(), strict=True)))
                  for _ in range(200)]
        found[name] = compute_information(own), max(chance) * 1.2
    return found


def relabel(room: RoomInstance) -> RoomInstance:
    """The room with its chain in the order of numbers: an index that gives the order away."""
    order = tuple(range(len(room.targets)))
    puzzle: Any = dataclasses.replace(room.puzzle, edge_list=tuple(itertools.pairwise(order)), goal=order[-1])
    return dataclasses.replace(room, puzzle=puzzle)


@pytest.mark.nightly_for("60")
@pytest.mark.parametrize("count", [60, pytest.param(400, marks=pytest.mark.slow)])
def test_neither_number_nor_place_tells_the_rank_of_a_button(count: int):
    rooms = list_rooms("chain-3", count)
    for name, (information, chance) in measure_features(rooms).items():
        assert information < chance, name
    planted = measure_features([relabel(room) for room in rooms])
    for name in ("number", "listed"):
        information, chance = planted[name]
        assert information == pytest.approx(math.log2(3)) and information > 2 * chance
