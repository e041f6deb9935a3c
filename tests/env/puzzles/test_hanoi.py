"""The Towers of Hanoi against three lists of discs, and its theorem: 2^n - 1 moves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.hanoi import HAND, HanoiConfig, HanoiPuzzle


@given(st.integers(1, 8), st.lists(st.integers(0, 2), max_size=60))
def test_presses_lift_and_put_down_as_three_stacks_do(discs, presses):
    puzzle = HanoiPuzzle(discs)
    state, stacks, hand = puzzle.make_state(), [list(range(discs - 1, -1, -1)), [], []], None
    for peg in presses:
        state = puzzle.update(state, Contacts((peg,)))
        if hand is None and stacks[peg]:
            hand = stacks[peg].pop()
        elif hand is not None and (not stacks[peg] or stacks[peg][-1] > hand):
            stacks[peg].append(hand)
            hand = None
        places = [HAND if disc == hand else next(p for p, stack in enumerate(stacks) if disc in stack)
                  for disc in range(discs)]
        assert puzzle.decode(state) == tuple(places)
        assert puzzle.is_state(state)
        assert puzzle.is_solved(state) == (len(stacks[2]) == discs)


@pytest.mark.parametrize("discs", [1, 2, 3, 5])
def test_the_shortest_solution_has_two_presses_for_each_of_its_moves(discs):
    puzzle = HanoiPuzzle(discs)
    seen, layer, presses = {puzzle.make_state()}, [puzzle.make_state()], 0
    while not any(map(puzzle.is_solved, layer)):
        layer = list({after for state in layer for peg in range(3)
                      if (after := puzzle.update(state, Contacts((peg,)))) not in seen})
        seen |= set(layer)
        presses += 1
    assert presses == 2 * (2**discs - 1)


def test_all_states_can_be_reached_and_keep_the_contract():
    puzzle = HanoiPuzzle(3)
    states, queue = {puzzle.make_state()}, [puzzle.make_state()]
    while queue:
        state = queue.pop()
        for after in (puzzle.update(state, Contacts((peg,))) for peg in range(3)):
            if after not in states:
                states.add(after)
                queue.append(after)
    at_rest = [state for state in states if HAND not in puzzle.decode(state)]
    assert len(at_rest) == 3**3
    assert {state for state in range(1 << 12) if puzzle.is_state(state)} >= states
    check_puzzle(HanoiConfig(discs=4).make_puzzle(np.random.default_rng(0)))
