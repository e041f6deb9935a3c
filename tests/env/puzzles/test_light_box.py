"""LightBox against a simulation of its own, its fewest presses, and their expected number by dynamic programming."""

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.light_box import LIGHT_BOX, LightBoxConfig, LightBoxPuzzle

PUBLISHED = LightBoxConfig().make_puzzle(np.random.default_rng(0))


@given(st.lists(st.tuples(st.integers(0, 19), st.floats(0, 1)), max_size=60))
def test_presses_do_what_a_graph_of_lights_does(presses):
    graph = networkx.DiGraph(LIGHT_BOX)
    state, on = PUBLISHED.make_state(), set()
    for light, chance in presses:
        state = PUBLISHED.update(state, Contacts((light,), uniform=chance))
        if chance < 0.9:
            if light in on:
                on -= {light, *networkx.descendants(graph, light)}
            else:
                on = on | {light} if set(graph.predecessors(light)) <= on else set()
        assert {i for i in range(20) if state >> i & 1} == on
        assert PUBLISHED.is_solved(state) == (19 in on)


@pytest.mark.nightly
def test_the_optimum_is_eleven_presses_and_more_by_the_chance_that_one_does_nothing():
    """Value iteration over all states that presses lead to, at a reward of -1 a press."""
    numbers, queue = {0: 0}, [0]
    for state in queue:
        for light in range(20):
            after = PUBLISHED.update(state, Contacts((light,)))
            if after not in numbers and not PUBLISHED.is_solved(state):
                numbers[after] = len(numbers)
                queue.append(after)
    after = np.array([[numbers.get(PUBLISHED.update(s, Contacts((light,))), 0) for light in range(20)] for s in queue])
    solved = np.array([PUBLISHED.is_solved(state) for state in queue])
    for chance in (1.0, 0.9):
        presses = np.where(solved, 0.0, 50.0)
        for _ in range(400):
            presses = np.where(solved, 0.0, 1 + (chance * presses[after] + (1 - chance) * presses[:, None]).min(axis=1))
        assert presses[0] == pytest.approx(11 / chance, abs=1e-9)


@pytest.mark.parametrize("success", [0.9, 1.0])
def test_boxes_keep_the_contract(success):
    for seed in range(3):
        config = LightBoxConfig(count=9, graph=GraphConfig(kind="random", max_parents=2), success=success)
        check_puzzle(config.make_puzzle(np.random.default_rng(seed)), steps=80)
    assert LightBoxPuzzle.from_dict(PUBLISHED.to_dict()) == PUBLISHED and PUBLISHED.is_random


def test_numbers_of_drawn_boxes_say_nothing_of_the_order():
    config = LightBoxConfig(count=6, graph=GraphConfig(kind="chain"))
    goals = {config.make_puzzle(np.random.default_rng(seed)).goal for seed in range(40)}
    assert len(goals) == 6
