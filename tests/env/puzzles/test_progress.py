"""Progress of every puzzle: the share of the facts on the way to the goal that hold, on or off."""

import numpy as np
import pytest

from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Contacts, Puzzle
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.codes import CodeLockPuzzle, PinPadPuzzle
from hrl_escape.env.puzzles.hanoi import HanoiPuzzle
from hrl_escape.env.puzzles.light_box import LIGHT_BOX, LightBoxPuzzle
from hrl_escape.env.puzzles.lights_out import LightsOutConfig, LightsOutPuzzle


def press(puzzle: Puzzle, *targets: int):
    state = puzzle.make_state()
    for target in targets:
        state = puzzle.update(state, Contacts((target,)))
    return puzzle.compute_progress(state)


def test_lights_that_must_be_off_count_as_those_that_must_be_on():
    board = LightsOutPuzzle(9, 3, start=0b111111111, goal=0)
    assert press(board) == 0.0
    assert press(board, 4) == 5 / 9  # the middle and its four neighbours are off
    assert press(board, 0, 2, 4, 6, 8) == 1.0
    task = LightsOutConfig(rows=4, columns=6, task=4).make_puzzle(np.random.default_rng(0))
    assert press(task) == 12 / 24, "a chequered board, whose goal has lights on in the corners alone"


@pytest.mark.parametrize(("puzzle", "targets", "share"), [
    (ButtonsPuzzle(4, ((0, 1), (1, 2)), goal=2), (0, 3), 1 / 3),
    (LightBoxPuzzle(20, LIGHT_BOX, goal=15), (0, 3, 2), 2 / 8),  # 15 needs 9 and 10, these 0, 3, 6, 1 and 4
    (BitFlipPuzzle(4), (0, 1), 2 / 4),
    (HanoiPuzzle(3), (0, 2), 1 / 3),
    (HanoiPuzzle(3), (0,), 0.0),
    (CodeLockPuzzle(code=(1, 0, 1), digits=2), (1, 0), 2 / 3),
    (PinPadPuzzle((1, 0)), (1,), 1 / 2),
], ids=lambda value: getattr(value, "kind", ""))  # fmt: skip
def test_it_is_the_share_of_what_the_goal_takes(puzzle, targets, share):
    assert press(puzzle, *targets) == pytest.approx(share)


@pytest.mark.parametrize("name", [name for name in PRESETS if name != "paper-random"])  # whose number is drawn
def test_every_puzzle_begins_unsolved(name):
    puzzle = get_preset(name).puzzle.make_puzzle(np.random.default_rng(3))
    for state in puzzle.list_starts()[:20]:
        assert 0.0 <= puzzle.compute_progress(state) < 1.0
