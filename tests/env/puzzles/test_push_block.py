"""The pushing puzzle's rule: a block counts while its centre is over its plate, wherever the plate lies."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.config import DynamicsConfig, RoomConfig
from hrl_escape.env.puzzles.base import Contacts, Prop
from hrl_escape.env.puzzles.push_block import PushBlockConfig, PushBlockPuzzle
from hrl_escape.errors import ConfigError

angle = st.floats(-math.pi, math.pi)
metre = st.floats(-10, 10)


def make_puzzle(count=1, plate_size=1.5):
    return PushBlockConfig(count=count, plate_size=plate_size).make_puzzle(np.random.default_rng(0))


@given(st.tuples(metre, metre, angle), st.floats(-2, 2), st.floats(-2, 2), angle)
def test_a_block_counts_exactly_while_its_centre_is_over_the_plate(plate, along, across, yaw):
    puzzle = make_puzzle()
    cos, sin = math.cos(plate[2]), math.sin(plate[2])
    block = (plate[0] + cos * along - sin * across, plate[1] + sin * along + cos * across, yaw)
    state = puzzle.update(puzzle.make_state(), Contacts((), (block, plate)))
    x, y, turn, is_on = puzzle.observe(state)
    assert (x, y) == pytest.approx((along, across), abs=1e-9)
    assert math.cos(4 * (turn - (yaw - plate[2]))) == pytest.approx(1.0)  # the same square
    assert -math.pi / 4 <= turn <= math.pi / 4
    if abs(abs(along) - 0.75) > 1e-9 and abs(abs(across) - 0.75) > 1e-9:
        inside = abs(along) < 0.75 and abs(across) < 0.75
        assert puzzle.is_solved(state) == inside == bool(is_on)


def test_all_blocks_must_lie_on_their_own_plates():
    puzzle = make_puzzle(count=2)
    here, there = (0.0, 0.0, 0.0), (5.0, 0.0, 0.0)

    def solve(*poses):
        state = puzzle.update(puzzle.make_state(), Contacts((), poses))
        return puzzle.is_solved(state), puzzle.get_facts(state)

    assert solve(here, here, there, there) == (True, {"on-plate(block-1)", "on-plate(block-2)"})
    assert solve(here, here, here, there) == (False, {"on-plate(block-1)"})
    assert solve(there, here, here, there) == (False, frozenset())  # swapped


def test_pushing_a_block_off_again_undoes_the_solution():
    puzzle = make_puzzle()
    plate = (1.0, 1.0, 0.0)
    on = puzzle.update(puzzle.make_state(), Contacts((), (plate, plate)))
    off = puzzle.update(on, Contacts((), ((3.0, 1.0, 0.0), plate)))
    assert (puzzle.is_solved(on), puzzle.is_solved(off)) == (True, False)


def test_kinematic_dynamics_are_refused():
    with pytest.raises(ConfigError, match="dynamics.kind.*'physics'.*push-block"):
        RoomConfig(puzzle=PushBlockConfig())
    RoomConfig(puzzle=PushBlockConfig(), dynamics=DynamicsConfig(kind="physics"))


def test_things_that_do_not_pair_up_are_refused():
    for things in ((), (Prop(),), (Prop("plate", "plate"), Prop())):
        with pytest.raises(ConfigError, match="block, plate"):
            PushBlockPuzzle(things)
