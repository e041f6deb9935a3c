"""The button puzzle against two independent models: a brute-force interpreter, and order theory."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle


@st.composite
def dags(draw, most):
    """(number of nodes, edges of a random DAG in random order, not sorted by number)."""
    count = draw(st.integers(1, most))
    order = draw(st.permutations(range(count)))
    pairs = [(order[i], order[j]) for i in range(count) for j in range(i + 1, count)]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=30)) if pairs else []
    return count, tuple(edges)


def press_by_hand(lit, button, edges, on_violation, allow_off):
    """One press, straight from the rule's words, on a set of button numbers."""
    if button in lit:
        return lit - {button} if allow_off else lit
    if all(parent in lit for parent, child in edges if child == button):
        return lit | {button}
    return set() if on_violation == "reset" else lit


@given(dags(12), st.sampled_from(["ignore", "reset"]), st.booleans(), st.data())
def test_presses_do_what_the_rule_says_on_any_dag(dag, on_violation, allow_off, data):
    count, edges = dag
    goal = data.draw(st.integers(0, count - 1))
    puzzle = ButtonsPuzzle(count, edges, goal, on_violation, allow_off)
    state, lit = puzzle.make_state(), set()
    for pressed in data.draw(st.lists(st.sets(st.integers(0, count - 1), max_size=3), max_size=40)):
        state = puzzle.update(state, Contacts(tuple(sorted(pressed))))
        for button in sorted(pressed):
            lit = press_by_hand(lit, button, edges, on_violation, allow_off)
        assert puzzle.get_lit(state) == tuple(i in lit for i in range(count))
        assert puzzle.observe(state) == tuple(float(i in lit) for i in range(count))
        assert puzzle.is_solved(state) == (goal in lit)


@given(dags(7))
def test_reachable_sets_of_lit_buttons_are_the_down_sets_of_the_dag(dag):
    """Order theory: from all off, pressing reaches exactly the sets that hold the parents of each member."""
    count, edges = dag
    puzzle = ButtonsPuzzle(count, edges, 0)
    reached, new = {puzzle.make_state()}, {puzzle.make_state()}
    while new:
        new = {puzzle.update(state, Contacts((i,))) for state in new for i in range(count)} - reached
        reached |= new
    down_sets = {
        sum(1 << i for i in chosen)
        for size in range(count + 1) for chosen in map(set, itertools.combinations(range(count), size))
        if all(parent in chosen for parent, child in edges if child in chosen)
    }
    assert reached == down_sets


def test_the_default_goal_comes_last_in_topological_order():
    for seed in range(20):
        puzzle = ButtonsConfig(count=6).make_puzzle(np.random.default_rng(seed))
        assert puzzle.goal not in {parent for parent, _ in puzzle.edges}
