"""The observation `objects`: rows that name no order, padded to the room configuration's largest number."""

import dataclasses
import math

import gymnasium
import numpy as np
import pytest

from hrl_escape.env.config import Between, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.observations.objects import OBJECT_WORDS
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate

VARIED = RoomConfig(room=ShapeConfig(width=12, depth=12), robot=RobotConfig(body_radius=0.5),
                    puzzle=ButtonsConfig(count=Between(2, 5), buttons=Panels(width=1.0)))


def observe(room, **changes):
    """Rows of the room's first start, one a dict of numbers by word, by name of the object."""
    rules = Kinematics(room)
    observer = make_observer("objects", rules)
    seen = observer.observe(rules.make_state(room.starts[0])._replace(**changes))
    rows = [name.removesuffix("-present") for name in observer.names if name.endswith("-present")]
    return {row: dict(zip(OBJECT_WORDS, numbers, strict=True))
            for row, numbers in zip(rows, seen[: 12 * len(rows)].reshape(-1, 12).tolist(), strict=True)}


def test_a_row_gives_type_pose_and_size_as_the_robot_sees_them():
    room = generate(get_preset("paper-two-button"), 0)
    rows = observe(room, x=2.0, y=0.0, heading_steps=9)  # facing +y
    diagonal, button = 2 * math.hypot(10, 10), room.targets[1]  # at (-9, 0), its width along y
    row = rows["button-2"]
    assert (row["target"], row["exit"], row["lit"]) == (1, 0, 0)
    assert row["ahead"] == pytest.approx(0, abs=1e-6) and row["left"] == pytest.approx(11 / diagonal)
    assert (row["sin"], row["cos"]) == pytest.approx((0, 1), abs=1e-6)
    assert row["half-x"] == pytest.approx(button.half_x / diagonal)
    assert observe(room, puzzle=0b10)["button-2"]["lit"] == 1
    assert observe(room, puzzle=0b11)["exit"]["lit"] == 1 > observe(room, puzzle=0b01)["exit"]["lit"]


def test_rows_of_absent_buttons_are_nought_and_marked_as_absent():
    rooms = [generate(VARIED, seed) for seed in range(12)]
    assert {len(room.targets) for room in rooms} == {2, 3, 4, 5}
    for room in rooms:
        rows = observe(room)
        assert [name for name, row in rows.items() if row["present"]] == [*room.puzzle.target_names, "exit"]
        assert not any(value for row in rows.values() if not row["present"] for value in row.values())


def test_renumbering_the_buttons_permutes_the_rows():
    room = generate(get_preset("clutter"), 0)
    swapped = dataclasses.replace(room, targets=tuple(
        dataclasses.replace(target, name=name)
        for target, name in zip(room.targets[::-1], room.puzzle.target_names, strict=True)))
    before, after = observe(room), observe(swapped)
    assert [before[f"button-{n}"] for n in (1, 2, 3, 4)] == [after[f"button-{n}"] for n in (4, 3, 2, 1)]
    assert before["exit"] == after["exit"]


def test_a_block_moves_in_its_row_when_it_is_pushed():
    env = gymnasium.make("hrl_escape/PushBlock-v1", observation="objects")
    seen, _ = env.reset(seed=0)
    names = env.unwrapped._observer.names
    room, state = env.unwrapped.instance, env.unwrapped.get_state()
    at = names.index("block-1-ahead")
    away = np.array([room.props[0].x - state.x, room.props[0].y - state.y])
    cos, sin = env.unwrapped.rules.get_rotation(state.heading_steps, state.heading_offset)
    diagonal = 2 * math.hypot(room.reach_x, room.reach_y)
    assert seen[at : at + 2] == pytest.approx(np.array([[cos, sin], [-sin, cos]]) @ away / diagonal, abs=1e-4)
    assert seen[names.index("block-1-block")] == seen[names.index("plate-1-plate")] == 1
    env.close()
