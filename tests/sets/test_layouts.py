"""Rooms that look alike: turned, mirrored or moved within the margin, and no others."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from benchmarks.freezing import freeze_manifest
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import VerificationError
from hrl_escape.sets.benchmark import Benchmark, certify_rung, find_overlaps, load_benchmark
from hrl_escape.sets.keys import LATEST_LAYOUTS, SeenLayouts, compute_keys, list_points
from hrl_escape.sets.manifest import Manifest, RungRecord, SetRecord
from tests.covering import thin
from tests.sets.small import make_config, make_manifest


def turn(room: RoomInstance, quarters: int, is_mirrored: bool) -> RoomInstance:
    """The room turned by quarters, after its y was mirrored; every part of it by its own rule."""
    sign, angle = (-1 if is_mirrored else 1), quarters * math.pi / 2
    cos, sin = round(math.cos(angle)), round(math.sin(angle))

    def move(part, **changes):
        x, y = part.x, part.y * sign
        return dataclasses.replace(part, x=cos * x - sin * y, y=sin * x + cos * y, **changes)

    def place(part):
        return move(part, yaw=math.remainder(part.yaw * sign + angle, math.tau))

    steps = round(math.tau / math.radians(room.robot.turn_step_deg))
    starts = tuple(move(start, heading_steps=(start.heading_steps * sign + quarters * steps // 4) % steps)
                   for start in room.starts)
    corners = [(cos * x - sin * y * sign, sin * x + cos * y * sign)
               for x in (room.exit.x_min, room.exit.x_max) for y in (room.exit.y_min, room.exit.y_max)]
    low, high = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
    exit_ = dataclasses.replace(room.exit, x_min=low[0], y_min=low[1], x_max=high[0], y_max=high[1])
    return dataclasses.replace(room, solids=tuple(map(place, room.solids)), targets=tuple(map(place, room.targets)),
                               starts=starts, exit=exit_)


def shift(room: RoomInstance, distance: float) -> RoomInstance:
    first, *others = room.targets
    return dataclasses.replace(room, targets=(dataclasses.replace(first, y=first.y + distance), *others))


def are_alike(first, second) -> bool:
    return second in SeenLayouts([first])


@pytest.mark.parametrize("quarters", thin(range(4), 2, 1))
@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize("config", [make_config(3, "chain"), get_preset("clutter")], ids=["plain", "clutter"])
def test_a_room_looks_like_itself_turned_and_mirrored(config, quarters, is_mirrored):
    room, other = generate(config, 3), generate(config, 4)
    turned = list_points(turn(room, quarters, is_mirrored))
    assert are_alike(list_points(room), turned) and not are_alike(list_points(other), turned)


def test_the_margin_has_no_borders():
    room = generate(make_config(3, "chain"), 0)
    hashes = []
    for start in np.linspace(0, 1, 11):
        here = shift(room, start)
        assert are_alike(list_points(here), list_points(shift(room, start + 0.49)))
        assert not are_alike(list_points(here), list_points(shift(room, start + 0.51)))
        hashes.append(compute_keys(here).layout == compute_keys(shift(room, start + 0.1)).layout)
    assert not all(hashes), "rounded places have borders at which a tenth of a metre makes a difference"


@pytest.mark.nightly
def test_points_are_paired_one_to_one():
    """Two near points of one name cannot both be the counterpart of one; held against every permutation."""
    chance = np.random.default_rng(0)
    found = []
    for _ in range(80):
        first, second = chance.uniform(0, 1.6, (2, 4, 2))
        by_hand = any((np.linalg.norm(image - second[list(order)], axis=1) <= 0.5).all()
                      for order in itertools.permutations(range(4))
                      for image in (turned * signs for turned in (first, first[:, ::-1])
                                    for signs in itertools.product((1, -1), repeat=2)))
        layouts = [tuple(("a", *map(float, point)) for point in points) for points in (first, second)]
        assert are_alike(*layouts) == by_hand
        found.append(by_hand)
    assert 5 < sum(found) < 75


def test_of_layouts_seen_the_first_that_looks_alike_is_named():
    rooms = [generate(make_config(3, "chain"), seed) for seed in range(4)]
    seen = SeenLayouts(map(list_points, rooms))
    assert [seen.find(list_points(turn(room, 1, True))) for room in rooms] == [0, 1, 2, 3]
    seen.update([list_points(rooms[2])])
    assert seen.find(list_points(shift(rooms[2], 0.3))) == 2
    assert seen.find(list_points(generate(get_preset("clutter"), 0))) is None


@pytest.mark.nightly
def test_a_new_benchmark_is_frozen_with_the_latest_layouts_and_published_ones_keep_theirs():
    assert make_manifest().layouts == LATEST_LAYOUTS == 2
    assert load_benchmark("ladder-1").manifest.layouts == 1
    old = dataclasses.replace(make_manifest(), layouts=1)
    assert freeze_manifest(old, "0").layouts == 1
    rooms = Benchmark(make_manifest())["one"].train[:2]
    keys = [compute_keys(room, 2) for room in rooms]
    mirrored = compute_keys(turn(rooms[1], 3, True), 2)
    assert find_overlaps({"train": keys, "test": [mirrored]}) == ["room 0 of test has the layout of room 1 of train"]


@pytest.mark.nightly
def test_a_room_that_looks_like_one_of_another_set_is_skipped_and_else_found_by_the_certificate():
    """Rooms that vary little, of which some look alike by chance."""
    config = make_config(1, "chain")
    shape = dataclasses.replace(config.room, width=6.0, depth=6.0)
    record = RungRecord(name="small", config=dataclasses.replace(config, room=shape), train=SetRecord(count=150),
                        valid=SetRecord(count=8), test=SetRecord(count=8))
    (frozen,) = freeze_manifest(Manifest(name="tight", rungs=(record,)), "0").rungs
    assert frozen.test.skipped or frozen.valid.skipped
    planted = {role: dataclasses.replace(getattr(frozen, role), skipped=()) for role in ("valid", "test")}
    bench = Benchmark(Manifest(name="tight", layouts=2, rungs=(dataclasses.replace(frozen, **planted),)))
    with pytest.raises(VerificationError, match="has the layout of room"):
        certify_rung(bench["small"])


@pytest.mark.nightly
def test_tasks_are_held_out_where_they_are_enough_different_ones():
    few = SetRecord(count=4)
    rungs = tuple(RungRecord(name=f"n{count}", config=make_config(count, kind), train=few, valid=few, test=few,
                             test_task=SetRecord(count=40)) for count, kind in ((2, "chain"), (5, "layered")))
    frozen = freeze_manifest(Manifest(name="held", rungs=rungs), "0").rungs
    assert [record.test_task for record in frozen] == [None, None], "five buttons have two such tasks"
    (many,) = freeze_manifest(Manifest(name="held", rungs=(dataclasses.replace(
        rungs[1], name="n8", config=make_config(8, "layered")),)), "0").rungs
    assert many.test_task is not None
    bench = Benchmark(Manifest(name="held", layouts=2, rungs=(many,)))
    assert len(set(bench["n8"].test_task.tasks)) >= 20
    told = str(certify_rung(bench["n8"]))
    assert f"test_task 40 ({len(set(bench['n8'].test_task.tasks))} tasks)" in told
