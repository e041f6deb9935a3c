"""Keys of rooms: content, layout and task."""

import dataclasses
import math

import numpy as np

from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import get_puzzle_kind, list_puzzles
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.keys import compute_keys, compute_task_key


def move(room, distance):
    solids = tuple(dataclasses.replace(solid, x=solid.x + distance) if solid.role == "obstacle" else solid
                   for solid in room.solids)
    return dataclasses.replace(room, solids=solids)


def test_a_hair_changes_content_and_not_layout():
    room = generate(get_preset("clutter"), 1)
    before, after = compute_keys(room), compute_keys(move(room, 1e-9))
    assert before.content != after.content and before.layout == after.layout and before.task == after.task
    assert before.content.startswith(room.id) and len(before.content) == 64


def test_another_place_changes_the_layout():
    room = generate(get_preset("clutter"), 1)
    assert compute_keys(room).layout != compute_keys(move(room, 1.0)).layout


def test_the_order_of_obstacles_is_no_part_of_the_layout():
    room = generate(get_preset("clutter"), 1)
    assert compute_keys(room).layout == compute_keys(dataclasses.replace(room, solids=room.solids[::-1])).layout


def test_names_of_buttons_are_no_part_of_the_task():
    puzzle = ButtonsPuzzle(4, ((0, 1), (0, 2), (1, 3), (2, 3)), 3)
    shuffled = ButtonsPuzzle(4, ((2, 0), (2, 3), (0, 1), (3, 1)), 1)
    assert compute_task_key(puzzle) == compute_task_key(shuffled)
    for other in (dataclasses.replace(puzzle, goal=0), dataclasses.replace(puzzle, on_violation="reset"),
                  dataclasses.replace(puzzle, edge_list=puzzle.edge_list[1:])):
        assert compute_task_key(puzzle) != compute_task_key(other)


def test_marks_are_part_of_the_room_and_no_part_of_its_task():
    """They show the order of presses and do not change it: else held-out tasks would come again under other cues."""
    room = load_benchmark("cues-1")["latent-codes"].train[0]
    bare, turned = (dataclasses.replace(room, puzzle=dataclasses.replace(room.puzzle, cues=cues))
                    for cues in ((), room.puzzle.cues[::-1]))
    marked, other, none = map(compute_keys, (room, turned, bare))
    assert room.puzzle.cues and marked.task == other.task == none.task
    assert len({marked.content, other.content, none.content}) == 3


def test_dead_ends_are_part_of_the_task_and_their_numbers_are_not():
    puzzle = ButtonsPuzzle(4, ((0, 3), (1, 3)), 3, locks=((2, 0), (1, 0)))
    shuffled = ButtonsPuzzle(4, ((2, 1), (3, 1)), 1, locks=((0, 2), (3, 2)))
    assert compute_task_key(puzzle) == compute_task_key(shuffled)
    for locks in ((), ((2, 0),), ((0, 1), (2, 0)), ((2, 0), (2, 1))):
        assert compute_task_key(puzzle) != compute_task_key(dataclasses.replace(puzzle, locks=locks))


def test_every_kind_of_puzzle_has_a_task():
    for kind in list_puzzles():
        puzzle = get_puzzle_kind(kind).config_type().make_puzzle(np.random.default_rng(0))
        assert len(compute_task_key(puzzle)) == 64


def test_a_full_turn_is_no_turn_in_the_layout():
    room = generate(get_preset("clutter"), 1)
    for turns, same in ((1, True), (-1, True), (0.5, False)):
        targets = tuple(dataclasses.replace(target, yaw=target.yaw + turns * math.tau) for target in room.targets)
        assert (compute_keys(dataclasses.replace(room, targets=targets)).layout == compute_keys(room).layout) == same
