"""Landmarks against their definition: without its achievers the goal is out of reach, deletes left aside."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.hierarchies.synthesise import find_landmarks

FACTS = "abcde"
SOME = st.frozensets(st.sampled_from(FACTS), max_size=2)
MODELS = st.lists(st.tuples(SOME, SOME, SOME, SOME), min_size=1, max_size=8).map(lambda sets: SymbolicModel(
    tuple(FACTS), tuple(Operator(f"do-{i}", "x", "press", needs, forbids - needs, adds, deletes - adds)
                        for i, (needs, forbids, adds, deletes) in enumerate(sets)), frozenset()))


def can_reach(model, facts, goal, without=""):
    """The goal's facts can all be made true where nothing stops being true or false, `without` never coming true."""
    true, false = set(facts), set(FACTS) - facts
    while True:
        size = len(true) + len(false)
        for op in model.operators:
            if op.preconditions <= true and op.forbidden <= false:
                true |= op.add - {without}
                false |= op.delete
        if len(true) + len(false) == size:
            return goal <= true


@pytest.mark.nightly
@given(MODELS, SOME, SOME)
@settings(max_examples=100)
def test_they_are_those_without_which_the_goal_is_out_of_reach(model, facts, goal):
    found = find_landmarks(model, facts, goal)
    assert (found is not None) == can_reach(model, facts, goal)
    if found is None:
        return
    assert set(found) == {fact for fact in FACTS if fact not in facts and not can_reach(model, facts, goal, fact)}
    for fact, earlier in found.items():
        assert earlier == {each for each in FACTS if each not in facts and each != fact
                           and not can_reach(model, facts, {fact}, each)}


@pytest.mark.nightly
@given(MODELS, SOME, st.sampled_from(FACTS))
@settings(max_examples=100)
def test_the_fewest_operators_make_a_plan_as_long_as_the_distance(model, facts, wanted):
    front, met, distance = {facts}, {facts}, 0
    while front and not any(wanted in each for each in front):
        front = {op.apply(each) for each in front for op in model.operators if op.is_applicable(each)} - met
        met |= front
        distance += 1
    plan = dataclasses.replace(model, goal=frozenset({wanted})).find_fewest(facts)
    assert (plan is not None) == bool(front)
    if plan is not None:
        assert len(plan) == distance
        for operator in plan:
            assert operator.is_applicable(facts)
            facts = operator.apply(facts)
        assert wanted in facts


def test_buttons_in_a_chain_are_landmarks_in_its_order_and_others_are_none():
    model = ButtonsPuzzle(4, ((2, 0), (0, 1)), goal=1).make_symbolic_model()
    on = [f"on(button-{number})" for number in (1, 2, 3)]
    assert find_landmarks(model, frozenset()) == {
        on[0]: frozenset({on[2]}), on[1]: frozenset({on[0], on[2]}), on[2]: frozenset()}
    assert find_landmarks(model, frozenset({on[2]})) == {on[0]: frozenset(), on[1]: frozenset({on[0]})}
    assert find_landmarks(BitFlipPuzzle(3).make_symbolic_model(), frozenset()).keys() == {
        "on(bit-1)", "on(bit-2)", "on(bit-3)"}
