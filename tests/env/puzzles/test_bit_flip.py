"""BitFlip against a list-of-bits interpreter of the domain's rule, and its shortest solution."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.puzzles.base import Contacts, Panels
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig, BitFlipPuzzle
from hrl_escape.errors import ConfigError


def flip_by_hand(bits, bit):
    if all(bits[:bit]):
        return [*bits[:bit], not bits[bit], *bits[bit + 1:]]
    return [False] * (bit + 1) + bits[bit + 1:]


@given(st.integers(1, 10), st.data())
def test_presses_flip_or_reset_as_the_domain_says(count, data):
    puzzle = BitFlipPuzzle(count)
    state, bits = puzzle.make_state(), [False] * count
    for bit in data.draw(st.lists(st.integers(0, count - 1), max_size=60)):
        state, bits = puzzle.update(state, Contacts((bit,))), flip_by_hand(bits, bit)
        assert puzzle.get_lit(state) == tuple(bits)
        assert puzzle.is_solved(state) == all(bits)


@pytest.mark.parametrize("count", range(1, 6))
def test_every_press_in_every_state_does_what_the_domain_says(count):
    puzzle = BitFlipPuzzle(count)
    for state in range(1 << count):
        for bit in range(count):
            reached = puzzle.update(state, Contacts((bit,)))
            assert puzzle.get_lit(reached) == tuple(flip_by_hand(list(puzzle.get_lit(state)), bit))


@pytest.mark.parametrize("count", range(1, 9))
def test_from_lowest_to_highest_is_the_only_shortest_solution(count):
    puzzle = BitFlipPuzzle(count)
    shortest = {puzzle.make_state(): 1}  # state: number of shortest ways to it
    seen = set(shortest)
    for length in range(1, count + 1):
        after: dict[int, int] = {}
        for state, ways in shortest.items():
            for bit in range(count):
                reached = puzzle.update(state, Contacts((bit,)))
                if reached not in seen:
                    after[reached] = after.get(reached, 0) + ways
        seen |= set(after)
        shortest = after
        solved = {state: ways for state, ways in after.items() if puzzle.is_solved(state)}
        assert solved == ({2**count - 1: 1} if length == count else {})


def test_four_paper_places_hold_four_bits_at_most():
    assert BitFlipConfig(count=4, buttons=Panels(places="paper")).count == 4
    with pytest.raises(ConfigError, match="puzzle.count = 5"):
        BitFlipConfig(count=5, buttons=Panels(places="paper"))
