"""Doors between the rooms of a sampled floor plan: buttons and keys open them, in an order that escapes."""

import dataclasses
import functools
import json
import math

import numpy as np
import pytest
import torch

from benchmarks.conformance import compare
from hrl_escape.checks import check_puzzle
from hrl_escape.env import RoomInstance, generate
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.config import (
    Between,
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import compute_distance, compute_first_contact
from hrl_escape.env.kinematics import CONTACT_SKIN, Kinematics
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.mixins import Doored
from hrl_escape.env.puzzles.places import Pads
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.env.sampling.certificate import find_unmet, make_floors
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import ConfigError, PlanningFailed, UnsupportedError
from hrl_escape.hierarchies.situation import Situations
from hrl_escape.options import OptionsEnv
from hrl_escape.planning import RoomPlanner, find_best_known
from hrl_escape.planning.lower_bounds import bound_escape
from hrl_escape.sets.keys import compute_task_key

CONFIG = get_preset("inner-doors")
SEEDS = range(4)


@functools.cache
def make_room(seed: int = 0) -> RoomInstance:
    return generate(CONFIG, seed)


@functools.cache
def make_planner(seed: int = 0) -> RoomPlanner:
    return RoomPlanner(make_room(seed))


def begin(room: RoomInstance):
    return Kinematics(room).make_state(room.starts[0])


def change(**fields) -> RoomConfig:
    return dataclasses.replace(CONFIG, puzzle=dataclasses.replace(CONFIG.puzzle, **fields))


def get_puzzle(room: RoomInstance) -> ButtonsPuzzle:
    assert isinstance(room.puzzle, ButtonsPuzzle)
    return room.puzzle


@pytest.mark.parametrize("length", [1.0, 1.45, 3.0])
def test_a_motion_of_any_length_stops_at_the_first_shut_door_or_solid(length):
    room, rng = make_room(), np.random.default_rng(0)
    rules, state = Kinematics(room), begin(room)
    solids = [*rules.footprints, *(door.footprint for door in room.inner_doors)]
    radius = room.robot.outer_radius + CONTACT_SKIN
    met = 0
    for number in range(1500):
        near = solids[number % len(solids)]
        x = near.x + rng.uniform(-1.0, 1.0) * (near.half_x + 2.0)
        y = near.y + rng.uniform(-1.0, 1.0) * (near.half_y + 2.0)
        if min(compute_distance(x, y, solid) for solid in solids) < radius + 0.01:
            continue
        angle = rng.integers(4) * math.pi / 2 + rng.uniform(-0.02, 0.02)
        move = length * math.cos(angle), length * math.sin(angle)
        first = min(1.0, *(compute_first_contact(x, y, *move, radius, solid) for solid in solids))
        assert rules.compute_free_fraction(x, y, *move, state.puzzle) == first
        met += first < 1.0
    assert met > 100



@pytest.mark.nightly_for("1", "2", "3")
@pytest.mark.parametrize("seed", SEEDS)
def test_every_room_is_certified_and_escaped_and_no_bound_is_broken(seed):
    room = make_room(seed)
    assert find_unmet_constraint(room) is None
    check_puzzle(room.puzzle, steps=40)
    rules, state = Kinematics(room), begin(room)
    bound, plan = bound_escape(room, state), make_planner(seed).solve(state)
    for primitive in plan.primitives:
        step = rules.step(state, primitive)
        state = step.state
    assert step.terminated and rules.has_escaped(state) and bound <= plan.cost
    assert find_best_known(room, begin(room)).value == 100 - plan.cost


@pytest.mark.parametrize("seed", SEEDS)
def test_the_doors_on_a_way_are_those_that_floor_space_says(seed):
    room = make_room(seed)
    doors = range(len(room.inner_doors))
    for target, way in enumerate(room.ways[:-1]):
        named = dataclasses.replace(room.targets[target], name="button-1")
        for shut in ([door for door in doors if door not in way], *([door] for door in way)):
            walled = dataclasses.replace(
                room, solids=(*room.solids, *(room.inner_doors[door] for door in shut)), inner_doors=(), ways=(),
                targets=(named,), puzzle=ButtonsPuzzle(1))
            blocked = (find_unmet(walled, make_floors(walled)) or "").startswith("button-1")
            assert blocked == (len(shut) == 1 and shut[0] in way)


@pytest.mark.nightly
def test_some_rooms_need_a_button_for_the_way_out_alone():
    graph, found = GraphConfig(kind="random", edge_probability=0), 0
    for seed in range(12):
        room = generate(change(count=3, doors=2, graph=graph), seed)
        needed = {op.target for op in room.symbolic_model.find_fewest(frozenset()) or ()}
        assert room.puzzle.target_names[get_puzzle(room).goal] in needed
        found += len(needed) > 1
    assert found > 2


@pytest.mark.nightly
def test_both_engines_agree_over_rooms_with_different_numbers_of_doors():
    rooms = [generate(change(count=Between(3, 6), doors=Between(0, 3)), seed) for seed in range(4)]
    assert len({len(room.inner_doors) for room in rooms}) > 2
    found = compare(rooms, 400, copies=10)
    assert not found.disagreements, found.disagreements[0]


@pytest.mark.slow  # four seconds: pytest -m slow tests/env/test_inner_doors.py
def test_both_engines_agree_over_100_000_primitives():
    found = compare([make_room()], 100_000, copies=500)
    assert found.primitives == 100_000 and not found.disagreements, found.disagreements[0]


@pytest.mark.nightly
def test_both_engines_agree_along_an_escape_and_on_what_is_seen():
    """Random play opens few doors: a plan opens all that it needs, and lidar looks through them."""
    room = make_room()
    rules, batch = Kinematics(room), TensorRoom(Rooms(instance=room, observation="egocentric"), autoreset="disabled")
    observer = make_observer("egocentric", rules)
    batch.reset(torch.tensor([0]))
    state = batch.get_room_state(0)
    assert state == begin(room)._replace(noise_key=state.noise_key)
    shut = []
    for primitive in make_planner().solve(begin(room)).primitives:
        assert np.abs(batch.observe()[0].numpy() - observer.observe(state)).max() < 1e-5
        batch.step(torch.tensor([primitive]))
        state = rules.step(state, primitive).state
        after = batch.get_room_state(0)
        assert abs(after.x - state.x) + abs(after.y - state.y) < 1e-9
        assert after._replace(x=state.x, y=state.y) == state
        shut.append(room.puzzle.get_shut(state.puzzle).bit_count())
    assert shut[0] == 3 and shut[-1] == 0 and rules.has_escaped(state)


def test_options_behind_shut_doors_are_masked_and_ancestors_open_the_way():
    room = make_room()
    behind = next(target for target in range(5) if room.ways[target])
    env = OptionsEnv(EscapeRoomEnv(instance=room), include_primitives=False)
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [not way for way in room.ways]
    env = OptionsEnv(EscapeRoomEnv(instance=room), option_set="press-with-ancestors", include_primitives=False)
    _, info = env.reset(seed=0)
    assert info["action_mask"][behind]
    _, _, _, _, info = env.step(behind)
    assert info["option"]["ended"] == "reached" and room.puzzle.get_lit(env.unwrapped.get_state().puzzle)[behind]


def test_a_goal_behind_a_shut_door_is_no_plan_and_one_behind_an_open_door_is():
    room, planner = make_room(), make_planner()
    behind = next(target for target in range(5) if room.ways[target])
    opened = sum(1 << get_puzzle(room).doors[door] for door in room.ways[behind])
    with pytest.raises(PlanningFailed):
        planner.plan(begin(room), f"press-button-{behind + 1}")
    assert planner.plan(begin(room)._replace(puzzle=opened), f"press-button-{behind + 1}").cost > 0


def test_large_puzzles_are_ordered_by_pairs_of_operators():
    room = generate(change(count=9, doors=3, graph=GraphConfig(kind="layered")), 1)
    state, rules = begin(room), Kinematics(room)
    for primitive in RoomPlanner(room).solve(state).primitives:
        state = rules.step(state, primitive).state
    assert rules.has_escaped(state)


def test_alcoves_obstacles_fixed_starts_and_files():
    config = dataclasses.replace(CONFIG, exit=ExitConfig(door=True, width=2.4), obstacles=ObstaclesConfig(count=6),
                                 start=StartConfig(place="fixed", x=6, y=6))
    room = generate(config, 0)
    assert find_unmet_constraint(room) is None and room.starts[0].x == 6
    again = RoomInstance.from_dict(json.loads(json.dumps(room.to_dict())))
    assert again == room and again.id == room.id
    with pytest.raises(ConfigError, match="instance.ways"):
        dataclasses.replace(room, ways=room.ways[:-1])


def test_numbers_of_buttons_make_no_other_task_and_openers_do():
    chain, shuffled = ((0, 1), (1, 2)), ((2, 0), (0, 1))
    keys = [compute_task_key(puzzle) for puzzle in (
        ButtonsPuzzle(3, chain, 2, doors=(0,)), ButtonsPuzzle(3, shuffled, 1, doors=(2,)),
        ButtonsPuzzle(3, chain, 2, doors=(1,)), ButtonsPuzzle(3, chain, 2))]
    assert keys[0] == keys[1] and len(set(keys)) == 3


# --- a stranger's puzzle: a key on the floor ------------------------------------------------


@dataclasses.dataclass(frozen=True)
class KeyConfig(PuzzleConfig):
    kind = "key-on-the-floor"

    def make_puzzle(self, rng):
        return KeyPuzzle()

    @property
    def pads(self):
        return Pads(1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class KeyPuzzle(Doored, Modelled, Puzzle):
    """Grip the key, which opens the door for good, then the treasure."""

    kind = "key-on-the-floor"
    target_names = property(lambda self: ("key", "treasure"))
    pad_names = target_names
    bounds = property(lambda self: ((0.0, 1.0), (0.0, 1.0)))
    door_facts = property(lambda self: ("held(key)",))

    def make_state(self):
        return 0

    def update(self, state, contacts: Contacts):
        return state | sum(1 << target for target in contacts.touching) if contacts.grip == 1 else state

    def is_solved(self, state):
        return bool(state & 2)

    def observe(self, state):
        return float(state & 1), float(state >> 1)

    def get_lit(self, state):
        return bool(state & 1), bool(state & 2)

    def get_facts(self, state):
        return frozenset(f"held({name})" for bit, name in enumerate(self.target_names) if state >> bit & 1)

    def make_symbolic_model(self):
        facts, none = tuple(f"held({name})" for name in self.target_names), frozenset()
        operators = tuple(Operator(f"take-{name}", name, "grip", none, frozenset({fact}), frozenset({fact}), none)
                          for name, fact in zip(self.target_names, facts, strict=True))
        return SymbolicModel(facts, operators, frozenset({facts[1]}))


@pytest.mark.nightly
def test_a_puzzle_of_ones_own_opens_a_door_with_a_key():
    check_puzzle(KeyPuzzle(), steps=40)
    config = RoomConfig(room=ShapeConfig(rooms=2), robot=RobotConfig(body_radius=0.5, gripper=True), puzzle=KeyConfig())
    lengths = set()
    for seed in range(4):
        room = generate(config, seed)
        assert room.ways[0] == ()
        state, rules = begin(room), Kinematics(room)
        plan = RoomPlanner(room).solve(state)
        for primitive in plan.primitives:
            state = rules.step(state, primitive).state
        assert rules.has_escaped(state)
        lengths.add(len(plan.parts))
    assert 3 in lengths, "in some room the key must be fetched"


# --- what is refused ------------------------------------------------------------------------


def test_impossible_doors_are_refused():
    for fields in ({"doors": 6}, {"allow_off": True}, {"on_violation": "reset"}, {"dead_ends": 1}):
        with pytest.raises(ConfigError, match="puzzle.doors"):
            change(**fields)
    with pytest.raises(ConfigError, match="room.rooms"):
        generate(dataclasses.replace(CONFIG, room=dataclasses.replace(CONFIG.room, rooms=3)), 0)
    by_hand = dataclasses.replace(CONFIG, robot=RobotConfig(body_radius=0.5, joints=3),
                                  dynamics=DynamicsConfig(press_with="hand"))
    with pytest.raises(ConfigError, match="arms reach past"):
        generate(by_hand, 0)
    with pytest.raises(ConfigError, match="opens inner doors"):
        generate(dataclasses.replace(CONFIG, dynamics=DynamicsConfig(kind="physics")), 0)


def test_parts_that_know_no_inner_doors_say_so():
    with pytest.raises(UnsupportedError, match="inner doors"):
        Situations(make_room())
