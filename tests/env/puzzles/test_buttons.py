"""The button puzzle against two independent models: a brute-force interpreter, and order theory."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import ConfigError


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


# --- dead ends -----------------------------------------------------------------------------------

LOCKED = ButtonsConfig(count=6, graph=GraphConfig(kind="layered", max_parents=2), dead_ends=4)


def press_one(lit, button, edges, locks):
    """One press, straight from the rule's words."""
    ready = all(parent in lit for parent, child in edges if child == button)
    return lit | {button} if ready and not any(b == button and a in lit for a, b in locks) else lit


def explore(puzzle):
    """{set of buttons that can be lit: sets one press later}, by the rule's words."""
    after, queue = {}, [frozenset()]
    for lit in queue:
        after[lit] = {press_one(lit, i, puzzle.edges, puzzle.locks) for i in range(puzzle.count)}
        queue += [then for then in after[lit] if then not in after and then not in queue]
    return after


def test_dead_ends_can_be_walked_into_and_avoided():
    """From the first state there is a way, of as many presses as the goal needs buttons; from some states none."""
    lost_by_number = 0
    for seed in range(40):
        puzzle = LOCKED.make_puzzle(np.random.default_rng(seed))
        assert len(puzzle.locks) == 4
        after = explore(puzzle)
        solvable = {lit for lit in after if puzzle.goal in lit}
        while grown := {lit for lit in after if after[lit] & solvable} - solvable:
            solvable |= grown
        assert frozenset() in solvable and len(solvable) < len(after), "there is a way, and there is a trap"
        model = puzzle.make_symbolic_model()
        for lit in after:
            state = sum(1 << i for i in lit)
            assert {puzzle.update(state, Contacts((i,))) for i in range(6)} == {sum(1 << i for i in then)
                                                                             for then in after[lit]}
            found = model.find_fewest(puzzle.get_facts(state))
            assert (found is not None) == (lit in solvable)
        needed = {puzzle.goal}
        while more := {parent for parent, child in puzzle.edges if child in needed} - needed:
            needed |= more
        fewest = model.find_fewest(puzzle.get_facts(0))
        assert fewest is not None and len(fewest) == len(needed)
        lit = frozenset()
        for button in 6 * list(range(6)):
            lit = press_one(lit, button, puzzle.edges, puzzle.locks)
        lost_by_number += puzzle.goal not in lit
    assert lost_by_number >= 32, "pressing by number is caught nearly always"


def test_dead_ends_need_buttons_that_stay_on_and_a_choice_of_order():
    with pytest.raises(ConfigError, match="turned off again"):
        ButtonsConfig(count=4, dead_ends=1, allow_off=True)
    with pytest.raises(ConfigError, match="neither needs the other"):
        ButtonsConfig(count=4, dead_ends=1).make_puzzle(np.random.default_rng(0))  # a chain
    with pytest.raises(ConfigError, match="cycles"):
        ButtonsPuzzle(3, ((0, 2), (1, 2)), 2, locks=((0, 1), (1, 0)))
