"""PDDL export, read back by unified-planning and solved by Fast Downward."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.symbolic import Effect, Operator, SymbolicModel
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import MissingExtraError, UnknownNameError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.symbolic.pddl import (
    clean_name,
    export_pddl,
    make_domain,
    make_problem,
    read_problem,
    run_engine,
    save_pddl,
)
from tests.covering import thin
from tests.env.rooms import make_ordered_chain


def solve(instance, state=None, engine="fast-downward"):
    """Operators of the plan that an independent planner finds in what is exported."""
    plan, status = run_engine(read_problem(*export_pddl(instance, state)), engine, 30.0)
    assert plan is not None, status
    operators = {clean_name(operator.name): operator for operator in instance.symbolic_model.operators}
    return [operators[action.action.name] for action in plan.actions]


@pytest.mark.nightly
@pytest.mark.nightly_for("paper-one-button", "twenty-button", "random-lights", "foraging")
@pytest.mark.parametrize("name", thin(list(PRESETS), 8))
def test_an_independent_planner_solves_every_preset_by_what_is_exported(name):
    instance = generate(get_preset(name), 0)
    model = instance.puzzle.symbolic.make_symbolic_model()
    facts = instance.puzzle.symbolic.get_facts(instance.puzzle.make_state())
    for operator in solve(instance):
        assert operator.is_applicable(facts)
        facts = operator.apply(facts)
    assert model.goal <= facts


@pytest.mark.nightly
def test_the_fewest_operators_are_as_many_as_our_own_search_uses():
    instance = generate(get_preset("ten-button"), 3)
    planner = RoomPlanner(instance)
    ours = planner.order_goals(planner.rules.make_state(instance.starts[0]))
    assert len(solve(instance, engine="fast-downward-opt")) == len(ours) - 1


@pytest.mark.nightly
def test_a_problem_begins_where_the_state_is():
    instance = generate(make_ordered_chain(), 0)
    state = Kinematics(instance).make_state(instance.starts[0])._replace(puzzle=0b0011)
    assert [operator.name for operator in solve(instance, state)] == ["press-button-3", "press-button-4"]
    assert "(on button-2)" in export_pddl(instance, state)[1]


def test_the_text_is_what_planners_read():
    model = ButtonsPuzzle(2, ((0, 1),), 1).make_symbolic_model()
    assert make_domain(model, "Two Buttons!") == """(define (domain two-buttons)
  (:requirements :strips :negative-preconditions)
  (:constants button-1 button-2)
  (:predicates (on ?x0))
  (:action press-button-1
    :parameters ()
    :precondition (and (not (on button-1)))
    :effect (and (on button-1)))
  (:action press-button-2
    :parameters ()
    :precondition (and (on button-1) (not (on button-2)))
    :effect (and (on button-2))))
"""
    assert "(:init (on button-1))" in make_problem(model, frozenset({"on(button-1)"}))


@pytest.mark.nightly_for("None-fast-downward", "5.0-fast-downward-opt")
@pytest.mark.parametrize(("dear", "engine"), [(None, "fast-downward"), (5.0, "fast-downward-opt")])
def test_conditional_effects_and_costs_are_read_and_heeded_by_an_independent_planner(
        dear, engine, monkeypatch, nothing_kept):
    """The long way works by a condition only (which that optimal planner does not take), or it is the cheap one."""
    none, done, ready = frozenset(), frozenset({"done"}), frozenset({"ready"})
    finish = Operator("finish", "button-2", "press", none, none, none, none, when=(Effect(ready, none, done, ready),))
    if dear:
        finish = Operator("finish", "button-2", "press", ready, none, done, none)
    ways = (Operator("prepare", "button-1", "press", none, none, ready, none), finish)
    ways += (Operator("dear", "button-1", "press", none, none, done, none, cost=dear),) if dear else ()
    model = SymbolicModel(("ready", "done"), ways, done)
    domain = make_domain(model)
    assert (":conditional-effects" in domain) == (not dear) and (":action-costs" in domain) == bool(dear)
    assert dear or "(when (and (ready)) (and (done) (not (ready))))" in domain
    monkeypatch.setattr(ButtonsPuzzle, "make_symbolic_model", lambda puzzle: model)
    monkeypatch.setattr(ButtonsPuzzle, "get_facts", lambda puzzle, state: none)
    found = solve(generate(get_preset("paper-one-button"), 0), engine=engine)
    assert [operator.name for operator in found] == ["prepare", "finish"]


def test_names_that_become_the_same_are_refused():
    nothing = frozenset()
    model = SymbolicModel(("on(A b)", "on(a-b)"), (Operator("x", "x", "press", *(nothing,) * 4),), nothing)
    with pytest.raises(ValueError, match="same name"):
        make_domain(model)


def test_files_are_written(tmp_path):
    instance = generate(get_preset("bit-flip"), int(np.random.default_rng(0).integers(5)))
    paths = save_pddl(instance, tmp_path)
    assert [path.read_text() for path in paths] == list(export_pddl(instance))


def test_a_missing_extra_is_named(monkeypatch):
    real = builtins.__import__

    def refuse(name, *rest, **more):
        if name.startswith("unified_planning"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingExtraError, match=r"\.\[pddl\]"):
        solve(generate(get_preset("paper-two-button"), 0))


@pytest.mark.nightly_for("up_grounder")
@pytest.mark.parametrize("engine", ["no-such-planner", "up_grounder", "sequential_simulator"])
def test_an_engine_that_is_no_planner_is_refused_by_name(engine):
    with pytest.raises(UnknownNameError, match="fast-downward"):
        solve(generate(get_preset("hanoi"), 0), engine=engine)
