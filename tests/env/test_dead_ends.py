"""Dead ends in whole rooms: certified, escaped by the planner, lost by pressing in the order of numbers."""

import functools

import gymnasium
import pytest

import hrl_escape
from benchmarks.conformance import compare
from hrl_escape.env.config import RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.places import Panels, Place
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import PlanningFailed
from hrl_escape.planning import RoomPlanner
from tests.env.isomorphism import check_isomorphism

assert hrl_escape  # registers the environments
CONFIG = get_preset("dead-ends")


@functools.cache
def make_room(seed: int):
    return generate(CONFIG, seed)


@pytest.mark.nightly_for("1", "2")
@pytest.mark.parametrize("seed", range(3))
def test_the_planner_avoids_dead_ends_and_the_certificate_holds(seed):
    room = make_room(seed)
    assert find_unmet_constraint(room) is None
    rules = Kinematics(room)
    state = rules.make_state(room.starts[0])
    plan = RoomPlanner(room).solve(state)
    for primitive in plan.primitives:
        step = rules.step(state, primitive)
        state = step.state
    assert step.terminated and rules.has_escaped(state)


def test_no_plan_leads_out_of_a_dead_end():
    room = make_room(0)
    locking, locked = room.puzzle.locks_between[0]
    state = Kinematics(room).make_state(room.starts[0])._replace(puzzle=1 << locking)
    with pytest.raises(PlanningFailed, match="precondition-unmet|No order"):
        RoomPlanner(room).solve(state)


@pytest.mark.nightly
def test_both_engines_agree_on_dead_ends():
    found = compare([make_room(seed) for seed in range(3)], 400, copies=4)
    assert not found.disagreements, found.disagreements[0]


@pytest.mark.nightly
def test_a_locked_button_is_that_of_a_state_machine():
    """Three buttons: the goal needs the first two, and the second locks the first."""

    class Machine:
        def list_states(self):
            return [(), (0,), (1,), (0, 1)]

        def step(self, lit, action):
            if action == 2:
                allowed = lit == (0, 1)
            else:
                allowed = action not in lit and not (action == 0 and 1 in lit)
            return tuple(sorted({*lit, action})) if allowed else lit

        def is_over(self, lit):
            return 2 in lit

        def encode(self, lit):
            return sum(1 << i for i in lit)

    graph = GraphConfig(kind="edges", edges=((0, 2), (1, 2)))
    places = (Place(-4, 4.95), Place(0, 4.95), Place(4, 4.95))
    config = RoomConfig(room=ShapeConfig(width=10, depth=10),
                        puzzle=ButtonsConfig(count=3, graph=graph, dead_ends=1, buttons=Panels(places=places)))
    room = next(room for seed in range(20) if (room := generate(config, seed)).puzzle.locks_between == ((1, 0),))
    assert check_isomorphism(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room), Machine()) == 12
