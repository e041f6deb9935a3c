"""Operators with conditional effects and costs, and models derived from rules, against search over the rules."""

import numpy as np
import pytest

from hrl_escape.env.puzzles.base import MOST_DERIVED, Contacts, DerivedModel
from hrl_escape.env.puzzles.codes import CodeLockConfig
from hrl_escape.env.puzzles.hanoi import HanoiPuzzle
from hrl_escape.env.puzzles.lights_out import LightsOutPuzzle
from hrl_escape.env.puzzles.symbolic import Effect, Operator, SymbolicModel
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.symbolic.operator_order import Leg, TaskSearch, find_relevant_operators

NONE: frozenset[str] = frozenset()


def facts(*names: str) -> frozenset[str]:
    return frozenset(names)


def test_conditions_are_looked_at_before_anything_changes():
    swap = Operator("swap", "t", "press", NONE, NONE, NONE, NONE, when=(
        Effect(facts("a"), NONE, facts("b"), facts("a")), Effect(facts("b"), NONE, facts("a"), facts("b")),
        Effect(NONE, facts("a", "b"), facts("c"), NONE)))
    assert swap.apply(facts("a")) == facts("b")
    assert swap.apply(facts("a", "b")) == facts("a", "b"), "what is added and deleted at once holds"
    assert swap.apply(NONE) == facts("c")
    assert swap.reads == facts("a", "b") and swap.may_add == facts("a", "b", "c")
    assert swap.relax(facts("a")) == facts("b", "c")


class Counter(LightsOutPuzzle):
    def update(self, state, contacts):
        return state + 1


@pytest.mark.nightly_for("puzzle1-512-5")
@pytest.mark.parametrize(("puzzle", "states", "fewest"), [
    (HanoiPuzzle(3), 3**3 + 3 * 3**2, 14), (LightsOutPuzzle(9, 3, 0, 0b111111111), 512, 5),
    (CodeLockConfig(digits=3, length=4).make_puzzle(np.random.default_rng(1)), 5, 4),
])
def test_a_derived_model_does_what_the_rules_do_and_has_the_shortest_solution(puzzle, states, fewest):
    derived, reached = DerivedModel(puzzle), [puzzle.make_state()]
    model = derived.make_symbolic_model()
    assert len(model.operators) == len(puzzle.target_names)
    for state in reached:
        for target in range(len(puzzle.target_names)):
            after = puzzle.update(state, Contacts((target,)))
            assert model.operators[target].apply(derived.get_facts(state)) == derived.get_facts(after)
            assert ("solved" in derived.get_facts(after)) == puzzle.is_solved(after)
            reached += [] if after in reached else [after]
    assert len(reached) == states and len(model.propositions) == states + 1
    path = model.find_fewest(facts("state(0)"))
    assert path is not None and len(path) == fewest
    order = TaskSearch(model).find_order(facts("state(0)"), None, lambda place, op: Leg(1.0, None))
    assert order is not None and len(order.operators) == fewest


def test_a_search_with_conditional_effects_finds_what_breadth_first_search_finds():
    rng = np.random.default_rng(0)
    names = tuple("abcdef")
    for _ in range(60):
        def draw(most: int) -> frozenset[str]:
            return frozenset(rng.choice(names, int(rng.integers(most + 1)), replace=False).tolist())

        operators = tuple(
            Operator(f"o{n}", "t", "press", draw(1), NONE, draw(1), NONE,
                     when=tuple(Effect(draw(2), draw(1), draw(1), draw(2)) for _ in range(2))) for n in range(5))
        model = SymbolicModel(names, operators, facts(*names[:3]))
        start = draw(2)
        path = model.find_fewest(start)
        for relevant_only in (True, False):
            order = TaskSearch(model, relevant_only=relevant_only).find_order(start, None, lambda p, o: Leg(1.0, None))
            assert (order and len(order.operators)) == (path if path is None else len(path)) or (path == () and order)


def test_an_operator_is_relevant_by_what_a_condition_reads():
    helper = Operator("help", "t", "press", NONE, NONE, facts("ready"), NONE)
    idle = Operator("idle", "t", "press", NONE, NONE, facts("noise"), NONE)
    finish = Operator("finish", "t", "press", NONE, NONE, NONE, NONE,
                      when=(Effect(facts("ready"), NONE, facts("done"), NONE),))
    model = SymbolicModel(("ready", "noise", "done"), (helper, idle, finish), facts("done"))
    assert find_relevant_operators(model) == (helper, finish)


def test_a_puzzle_of_too_many_states_is_told_to_bring_a_model():
    with pytest.raises(UnsupportedError, match=f"'lights-out' has more than {MOST_DERIVED:,} states. Make it Modelled"):
        DerivedModel(Counter(1, 1)).make_symbolic_model()
