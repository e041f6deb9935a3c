"""Task planning against brute force over all orders, and against its own exact search."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.planning.symbolic.operator_order import Leg, TaskSearch, find_relevant_operators


def find_ancestors(puzzle: ButtonsPuzzle) -> set[int]:
    found, waiting = set(), [puzzle.goal]
    while waiting:
        button = waiting.pop()
        if button not in found:
            found.add(button)
            waiting += [parent for parent, child in puzzle.edge_list if child == button]
    return found


def find_cheapest_by_force(puzzle: ButtonsPuzzle, places: np.ndarray, start, exit_) -> float:
    """Every order of the goal and its ancestors that keeps parents first."""
    needed = find_ancestors(puzzle)
    best = math.inf
    for order in itertools.permutations(needed):
        position = {button: i for i, button in enumerate(order)}
        if all(position[p] < position[c] for p, c in puzzle.edge_list if p in needed and c in needed):
            stops = [start, *(places[b] for b in order), exit_]
            best = min(best, sum(math.dist(a, b) for a, b in itertools.pairwise(stops)))
    return best


def make_extend(puzzle, places, exit_=(1.0, 1.0)):
    def extend(place, operator):
        at = exit_ if operator is None else tuple(places[puzzle.target_names.index(operator.target)])
        return Leg(math.dist(place, at), at)

    return extend


def make_bound(puzzle, places, start=(0.0, 0.0), exit_=(1.0, 1.0)):
    def find(operator, otherwise):
        return otherwise if operator is None else places[puzzle.target_names.index(operator.target)]

    return lambda last, then: math.dist(find(last, start), find(then, exit_))


@given(st.integers(1, 6), st.floats(0, 1), st.integers(0, 10_000))
@example(6, 0.1875, 586)  # siblings once inherited each other's bound
@settings(max_examples=60)
def test_the_order_is_the_cheapest_of_all_that_keep_parents_first(count, density, seed):
    rng = np.random.default_rng(seed)
    edges = tuple((i, j) for i in range(count) for j in range(i + 1, count) if rng.random() < density)
    puzzle, places = ButtonsPuzzle(count, edges, count - 1), rng.random((count, 2))
    expected = find_cheapest_by_force(puzzle, places, (0.0, 0.0), (1.0, 1.0))
    for bound in (lambda last, then: 0.0, make_bound(puzzle, places)):
        found = TaskSearch(puzzle.make_symbolic_model(), lower_bound=bound).find_order(
            frozenset(), (0.0, 0.0), make_extend(puzzle, places))
        assert found is not None and found.cost <= found.lower_bound
        assert found.cost == pytest.approx(expected)
        pressed = [places[puzzle.target_names.index(operator.target)] for operator in found.operators]
        stops = [(0.0, 0.0), *pressed, (1.0, 1.0)]
        assert sum(itertools.starmap(math.dist, itertools.pairwise(stops))) == pytest.approx(found.cost)


def test_an_order_beyond_the_search_limit_states_a_lower_bound_that_holds():
    rng = np.random.default_rng(1)
    count = 9
    puzzle, places = ButtonsPuzzle(count, tuple((i, 8) for i in range(8)), 8), rng.random((count, 2))
    search = TaskSearch(puzzle.make_symbolic_model(), lower_bound=make_bound(puzzle, places))
    exact = search.find_order(frozenset(), (0.0, 0.0), make_extend(puzzle, places))
    hasty = search.find_order(frozenset(), (0.0, 0.0), make_extend(puzzle, places), largest=200)
    assert exact.cost <= exact.lower_bound and hasty.cost > hasty.lower_bound
    assert hasty.lower_bound <= exact.cost + 1e-9 <= hasty.cost + 2e-9


def test_operators_that_cannot_matter_are_left_out():
    puzzle = ButtonsPuzzle(5, ((0, 1), (2, 3)), goal=1)
    names = [operator.name for operator in find_relevant_operators(puzzle.make_symbolic_model())]
    assert names == ["press-button-1", "press-button-2"]


def test_operators_that_undo_a_goal_are_left_out_unless_something_asks_for_that():
    names = [operator.name for operator in find_relevant_operators(BitFlipPuzzle(3).make_symbolic_model())]
    assert names == ["set-bit-1", "set-bit-2", "set-bit-3"], "nothing needs a bit cleared"
    none, lamp, door = frozenset(), frozenset({"lamp"}), frozenset({"door"})
    light = Operator("light", "a", "press", none, lamp, lamp, none)
    dim = Operator("dim", "b", "press", lamp, none, none, lamp)
    open_door = Operator("open", "c", "press", none, lamp, door, none)
    shut = Operator("shut", "d", "press", door, none, none, door)
    model = SymbolicModel(("lamp", "door"), (light, dim, open_door, shut), door)
    assert find_relevant_operators(model) == (dim, open_door), "the door opens in the dark only"
    assert find_relevant_operators(model, ("lamp", "door")) == (light, dim, open_door)


FACTS = "abcd"
SOME = st.frozensets(st.sampled_from(FACTS), max_size=2)


def find_shortest(operators, facts, goal):
    """Length of the shortest plan by breadth-first search; None without one."""
    front, met, length = {facts}, {facts}, 0
    while front:
        if any(goal <= each for each in front):
            return length
        front = {op.apply(each) for each in front for op in operators if op.is_applicable(each)} - met
        met |= front
        length += 1
    return None


@pytest.mark.nightly
@given(st.lists(st.tuples(SOME, SOME, SOME, SOME), min_size=1, max_size=7), SOME, SOME)
@settings(max_examples=100)
def test_without_irrelevant_operators_every_goal_is_as_near_as_with_them(sets, goal, facts):
    operators = tuple(Operator(f"do-{i}", "x", "press", needs, forbids - needs, adds, deletes - adds)
                      for i, (needs, forbids, adds, deletes) in enumerate(sets))
    relevant = find_relevant_operators(SymbolicModel(tuple(FACTS), operators, goal))
    assert find_shortest(relevant, facts, goal) == find_shortest(operators, facts, goal)


def test_what_is_done_already_is_not_done_again():
    puzzle = ButtonsPuzzle(3, ((0, 1), (1, 2)), goal=2)
    found = TaskSearch(puzzle.make_symbolic_model()).find_order(
        puzzle.get_facts(0b011), (0.0, 0.0), make_extend(puzzle, np.zeros((3, 2))))
    assert [operator.name for operator in found.operators] == ["press-button-3"]


def test_impossible_legs_are_gone_round_or_reported():
    puzzle, places = ButtonsPuzzle(3, (), goal=2), np.random.default_rng(0).random((3, 2))
    inner = make_extend(puzzle, places)
    search = TaskSearch(puzzle.make_symbolic_model())
    assert search.find_order(frozenset(), (0.0, 0.0), lambda p, op: inner(p, op) if op else None) is None
    needs_both = ButtonsPuzzle(3, ((0, 2), (1, 2)), goal=2)
    search = TaskSearch(needs_both.make_symbolic_model())
    no_direct = search.find_order(frozenset(), (0.0, 0.0), lambda p, op: None if op and op.target == "button-1"
                                  and p == (0.0, 0.0) else inner(p, op))
    assert [op.target for op in no_direct.operators] == ["button-2", "button-1", "button-3"]


def test_a_puzzle_that_can_undo_is_solved_too():
    puzzle = BitFlipPuzzle(4)
    found = TaskSearch(puzzle.make_symbolic_model()).find_order(
        puzzle.get_facts(0b1000), None, lambda place, op: Leg(1.0, None))
    state = 0b1000
    for operator in found.operators:
        state = puzzle.update(state, Contacts((puzzle.target_names.index(operator.target),)))
    assert puzzle.is_solved(state)


def test_what_an_operator_undoes_is_done_after_it():
    """Raising the bridge is cheap, and lowers the gate."""
    nothing, gate, bridge = frozenset(), frozenset({"gate"}), frozenset({"bridge"})
    operators = (Operator("gate", "gate", "press", nothing, nothing, gate, nothing),
                 Operator("bridge", "bridge", "press", nothing, nothing, bridge, gate))
    found = TaskSearch(SymbolicModel(("gate", "bridge"), operators, gate | bridge)).find_order(
        nothing, "", lambda place, op: Leg(5.0 if (place, op and op.name) == ("bridge", "gate") else 1.0,
                                           op.name if op else place))
    assert [operator.name for operator in found.operators] == ["bridge", "gate"] and found.cost == 7.0
