"""Tables of presses: exact posteriors in small cases, latent tasks, and no table where nothing can be learned."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from hrl_escape.agents.components.press_tables import (
    PairTables,
    RoomPresses,
    TableSettings,
    fit_press_tables,
    pack_press_tables,
    unpack_press_tables,
)

FEW = TableSettings(steps=120)


def search(parents: dict[int, set[int]], rng: np.random.Generator, symbols=(), sectors=None) -> RoomPresses:
    """Press buttons that can still light in random order until all are on."""
    count = len(parents)
    room, lit = RoomPresses.begin(symbols, [0] * count if sectors is None else sectors), set()
    while len(lit) < count:
        off = np.array([button not in lit for button in range(count)])
        button = int(rng.choice([b for b in range(count) if off[b] and not room.fails(b, off)]))
        room.note(button, off, parents[button] <= lit)
        lit |= {button} if parents[button] <= lit else set()
    return room


def make_chain(order) -> dict[int, set[int]]:
    return {button: set(order[:place]) for place, button in enumerate(order)}


def test_presses_keep_what_they_imply():
    room, off = RoomPresses.begin((), [0] * 3), np.array([True, True, True])
    room.note(2, off, False)
    assert room.fails(2, off) and not room.fails(2, np.array([False, True, True]))
    room.note(0, off, True)
    room.note(2, np.array([False, True, True]), False)
    assert [others.tolist() for others in room.failures[2]] == [[False, True, False]], "the larger set is implied"
    assert room.lights(0, off) and not room.lights(1, off) and room.order == [0]


def test_pair_tables_condition_on_failures_and_lights_exactly():
    """Against all sets of blocking buttons, weighed by their probability and by the presses they agree with."""
    settings = TableSettings(members=4, tasks=2)
    tables = PairTables("number", settings, 4, torch.Generator().manual_seed(0))
    with torch.no_grad():
        tables.table += torch.randn(tables.table.shape, generator=torch.Generator().manual_seed(1))
        tables.prior += torch.randn(tables.prior.shape, generator=torch.Generator().manual_seed(2))
    room = RoomPresses.begin((), [0] * 4)
    room.note(3, np.array([True] * 4), False)
    room.note(0, np.array([True] * 4), True)
    off = np.array([False, True, True, True])
    found, _ = tables.predict(room, off)
    blocked = torch.sigmoid(tables.table + tables.rows[..., None] + tables.base[..., None, None]).detach().double()
    prior = torch.softmax(tables.prior.detach().double(), 1) / settings.members
    for button in (1, 2, 3):
        agrees = lights = 0.0
        for own in itertools.product((0, 1), repeat=3):  # what blocks `button`
            others = [j for j in range(4) if j != button]
            chance = torch.ones_like(prior)
            for has, other in zip(own, others, strict=True):
                q = blocked[..., button, other]
                chance = chance * (q if has else 1 - q)
            if button == 3 and not any(own):
                continue
            evidence = torch.stack([1 - blocked[..., 0, j] for j in (1, 2, 3)]).prod(0)
            if button != 3:
                evidence = evidence * (1 - torch.stack([1 - blocked[..., 3, j] for j in (0, 1, 2)]).prod(0))
            weight = float((prior * chance * evidence).sum())
            agrees += weight
            lights += weight * (not any(has and off[other] for has, other in zip(own, others, strict=True)))
        assert found[button] == pytest.approx(lights / agrees, abs=1e-4)
    assert found[0] == 0


def test_symbols_of_a_chain_are_learned_from_a_few_rooms():
    rng, rooms = np.random.default_rng(0), []
    for _ in range(16):
        order = rng.permutation(4).tolist()
        rooms.append(search(make_chain(order), rng, [10 + order.index(button) for button in range(4)]))
    tables = fit_press_tables(rooms, FEW, 4, 0)
    assert tables is not None and tables.cue == "symbol"
    room = RoomPresses.begin([12, 10, 13, 11], [0] * 4)
    assert tables.predict(room, np.array([True] * 4))[0].argmax() == 1
    room.note(1, np.array([True] * 4), True)
    odds, _ = tables.predict(room, np.array([True, False, True, True]))
    assert odds.argmax() == 3 and odds[3] > 0.7


def test_a_press_reveals_which_of_two_tasks_a_room_has():
    """Numbers 0 to 3 are in one order or in the reverse; the first light shows which."""
    rng = np.random.default_rng(0)
    rooms = [search(make_chain([0, 1, 2, 3] if rng.random() < 0.5 else [3, 2, 1, 0]), rng) for _ in range(24)]
    tables = fit_press_tables(rooms, FEW, 4, 0)
    assert tables is not None and (tables.cue, tables.prior.shape[1]) == ("number", 4)
    for first, second in ((0, 1), (3, 2)):
        room, off = RoomPresses.begin((), [0] * 4), np.array([True] * 4)
        room.note(first, off, True)
        off[first] = False
        assert tables.predict(room, off)[0].argmax() == second


def test_random_orders_give_no_table_and_tables_survive_packing():
    rng = np.random.default_rng(1)
    sectors = [0, 5, 9, 13]
    rooms = [search(make_chain(rng.permutation(4).tolist()), rng, rng.permutation(32)[:4].tolist(), sectors)
             for _ in range(24)]
    tables = fit_press_tables(rooms, FEW, 4, 0, cues=("symbol", "plug"))
    room, off = RoomPresses.begin([1, 2, 3, 4], sectors), np.array([True] * 4)
    if tables is not None:  # chance can favour one a little
        odds, _ = tables.predict(room, off)
        assert (odds / odds.sum()).max() < 0.5
    number = fit_press_tables([search(make_chain([2, 0, 1, 3]), rng) for _ in range(8)], FEW, 4, 0)
    assert number is not None
    again = unpack_press_tables(pack_press_tables(number), FEW, 4)
    np.testing.assert_array_equal(again.predict(room, off), number.predict(room, off))
