"""The contract checks pass on everything registered, and find what they claim to find."""

import dataclasses

import numpy as np
import pytest

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts, get_puzzle_kind, list_puzzles
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.push_block import PushBlockConfig, PushBlockPuzzle
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.errors import ContractError
from tests.covering import thin

# --- puzzles ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", thin(range(5), 5))
@pytest.mark.parametrize("kind", list_puzzles())
def test_every_registered_puzzle_keeps_its_contract(kind, seed):
    puzzle = get_puzzle_kind(kind).config_type().make_puzzle(np.random.default_rng(seed))
    check_puzzle(puzzle, seed=seed)


@pytest.mark.parametrize("config", [
    ButtonsConfig(count=64, graph=GraphConfig(kind="random", max_parents=5)),
    ButtonsConfig(count=9, graph=GraphConfig(kind="layered", max_parents=3), on_violation="reset", allow_off=True),
    ButtonsConfig(count=5, graph=GraphConfig(kind="tree"), goal=0),
    ButtonsConfig(count=6, graph=GraphConfig(kind="layered", max_parents=2), on_violation="fail", dead_ends=1),
    PushBlockConfig(count=3),
    get_puzzle_kind("bit-flip").config_type(count=12),
], ids=str)
def test_large_and_odd_puzzles_keep_their_contract(config):
    check_puzzle(config.make_puzzle(np.random.default_rng(0)))


class Impure(ButtonsPuzzle):
    calls = 0

    def update(self, state, contacts):
        type(self).calls += 1
        return super().update(state, contacts) ^ (type(self).calls % 7 == 0)


class Word(int):
    __hash__ = None


class Mutable(ButtonsPuzzle):
    def make_state(self):
        return Word(0)


class ShortObservation(ButtonsPuzzle):
    def observe(self, state):
        return super().observe(state)[state > 0 :]


class OutOfBounds(ButtonsPuzzle):
    def observe(self, state):
        return tuple(2.0 * value for value in super().observe(state))


class IntegerObservation(ButtonsPuzzle):
    def observe(self, state):
        return tuple(int(value) for value in super().observe(state))


class UnknownFact(ButtonsPuzzle):
    def get_facts(self, state):
        return super().get_facts(state) | {"solved"}


class SolvedTooLate(ButtonsPuzzle):
    def is_solved(self, state):
        return state == 2**self.count - 1


class NeverSolvedByHand(ButtonsPuzzle):
    def update(self, state, contacts):
        return super().update(state, contacts) & ~(1 << self.goal)


class ForgetsParents(ButtonsPuzzle):
    def make_symbolic_model(self):
        model = super().make_symbolic_model()
        operators = (dataclasses.replace(op, preconditions=frozenset()) for op in model.operators)
        return dataclasses.replace(model, operators=tuple(operators))


class ForgetsReset(ButtonsPuzzle):
    def make_symbolic_model(self):
        model, nothing = super().make_symbolic_model(), frozenset()
        early = Operator("press-too-early", self.target_names[-1], "press", nothing,
                         frozenset({f"on({self.target_names[0]})"}), nothing, nothing)
        return dataclasses.replace(model, operators=(*model.operators, early))


class NoSuchTarget(ButtonsPuzzle):
    def make_symbolic_model(self):
        model = super().make_symbolic_model()
        operators = (dataclasses.replace(op, target="lever") for op in model.operators)
        return dataclasses.replace(model, operators=tuple(operators))


class UnreachableGoal(ButtonsPuzzle):
    def make_symbolic_model(self):
        model = super().make_symbolic_model()
        return dataclasses.replace(model, operators=model.operators[:-1])


class BackwardsPresses(ButtonsPuzzle):
    def update(self, state, contacts):
        return super().update(state, Contacts(contacts.pressed[::-1], contacts.prop_poses))


class LosesAField(ButtonsPuzzle):
    def to_dict(self):
        return {name: value for name, value in super().to_dict().items() if name != "edge_list"}


class WrongEdge(ButtonsPuzzle):
    @property
    def edges(self):
        return ((0, 9),)


class DarkForEver(ButtonsPuzzle):
    def get_lit(self, state):
        return ()


class FailsWhenSolved(ButtonsPuzzle):
    def is_failed(self, state):
        return self.is_solved(state)


CHAIN = ((0, 1), (1, 2))


@pytest.mark.parametrize(("puzzle", "claim"), [
    (Impure(3, CHAIN, 2), "pure"),
    (Mutable(3, CHAIN, 2), "hashable"),
    (ShortObservation(3, CHAIN, 2), "one number for each"),
    (OutOfBounds(3, CHAIN, 2), "within their bounds"),
    (IntegerObservation(3, CHAIN, 2), "floats"),
    (UnknownFact(3, CHAIN, 2), "facts are propositions"),
    (SolvedTooLate(3, ((0, 2),), 2), "is_solved exactly"),
    (NeverSolvedByHand(3, CHAIN, 2), "predicts what update does"),
    (ForgetsParents(3, CHAIN, 2), "predicts what update does"),
    (ForgetsReset(3, ((0, 2), (1, 2)), 2, "reset"), "predicts what update does"),
    (NoSuchTarget(3, CHAIN, 2), "presses, grips or uses a target"),
    (UnreachableGoal(3, CHAIN, 2), "can be reached"),
    (BackwardsPresses(3, CHAIN, 2), "index order"),
    (LosesAField(3, CHAIN, 2), "JSON"),
    (WrongEdge(3, CHAIN, 2), "edges"),
    (DarkForEver(3, CHAIN, 2), "bool for each target"),
    (FailsWhenSolved(3, CHAIN, 2), "never of a solved puzzle"),
], ids=lambda value: type(value).__name__ if isinstance(value, ButtonsPuzzle) else "")
def test_a_wrong_puzzle_is_found_out(puzzle, claim):
    with pytest.raises(ContractError, match=claim):
        check_puzzle(puzzle)


def test_a_push_that_does_not_count_is_found_out():
    class Forgetful(PushBlockPuzzle):
        def update(self, state, contacts):
            return state

    with pytest.raises(ContractError, match="push-block-1-onto-plate-1.*predicts"):
        check_puzzle(Forgetful(PushBlockConfig().make_puzzle(np.random.default_rng(0)).props))
