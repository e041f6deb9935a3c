"""The contract of puzzles: four members make one, and what few puzzles have are mixins that the others do without."""

import dataclasses

import pytest
import torch

from hrl_escape import RoomConfig, RoomPlanner, generate
from hrl_escape.checks import check_puzzle
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.palette import name_target
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import DerivedModel, Panels, Puzzle, PuzzleConfig
from hrl_escape.env.puzzles.mixins import Barring, Depicted, Doored, Graphed, Mapped, Propped, Pushing, get_mixin
from hrl_escape.env.puzzles.symbolic import Modelled
from hrl_escape.errors import UnsupportedError


@dataclasses.dataclass(frozen=True)
class PairConfig(PuzzleConfig):
    kind, panels = "pair", Panels(width=1.5)

    def make_puzzle(self, rng):
        return Pair()


@dataclasses.dataclass(frozen=True)
class Pair(Puzzle):
    """Press a, then b."""

    kind, target_names = "pair", ("a", "b")

    def make_state(self):
        return ""

    def update(self, state, contacts):
        for pressed in contacts.pressed:
            state = ("ab" if state == "a" else state) if pressed else state or "a"
        return state

    def is_solved(self, state):
        return state == "ab"

    def observe(self, state):
        return (len(state) / 2,)


def test_four_members_make_a_puzzle_that_is_checked_planned_drawn_and_run_in_a_batch():
    assert Puzzle.__abstractmethods__ == {"update", "is_solved"}  # and `kind` and names
    check_puzzle(Pair())
    room = generate(RoomConfig(name="pair", puzzle=PairConfig()), 0)
    rules, batch = Kinematics(room), TensorRoom(Rooms(instance=room))
    batch.reset(torch.tensor([0]))
    plan = RoomPlanner(room).solve(rules.make_state(room.starts[0], batch.get_room_state(0).noise_key))
    for number, primitive in enumerate(plan.primitives):
        batch.step(torch.tensor([primitive]))
        if number + 1 < len(plan.primitives):
            assert batch.get_room_state(0).puzzle == plan.states[number + 1].puzzle
    assert name_target(room.puzzle, "", 0) == "a" and room.puzzle.get_lit("ab") == (False, False)


def test_a_puzzle_without_a_trait_has_nothing_of_it():
    pair = Pair()
    graph, level = get_mixin(pair, Graphed), get_mixin(pair, Mapped)
    assert (graph.edges, graph.locks_between, graph.goal_targets) == ((), (), ())
    assert (level.map_rows, level.target_cells, level.blockable_cells, level.list_cells("", "grip", 0)) == ((),) * 4
    assert get_mixin(pair, Barring).get_shut("") == get_mixin(pair, Doored).get_shut("") == 0
    assert get_mixin(pair, Depicted).puddles == get_mixin(pair, Propped).props == ()
    with pytest.raises(UnsupportedError, match="no blocks or plates"):
        get_mixin(pair, Propped).with_props(())
    assert isinstance(pair.symbolic, DerivedModel) and pair.symbolic is pair.symbolic


@pytest.mark.nightly_for("puddle-world-mixins5")
@pytest.mark.parametrize(("preset", "mixins"), [
    ("paper-two-button", {Graphed, Doored, Barring}), ("sokoban", {Mapped, Pushing, Barring}), ("deep-sea", set()),
    ("push-block", {Propped}), ("recipes", {Graphed, Depicted}), ("puddle-world", {Depicted})])
def test_a_puzzle_with_a_trait_is_asked_itself(preset, mixins):
    puzzle = generate(get_preset(preset), 0).puzzle
    every = {Graphed, Depicted, Barring, Doored, Mapped, Pushing, Propped}
    assert {mixin for mixin in every if get_mixin(puzzle, mixin) is puzzle} == mixins
    assert isinstance(puzzle, Modelled) == (preset not in ("deep-sea", "puddle-world"))
    assert (puzzle.symbolic is puzzle) == isinstance(puzzle, Modelled)
