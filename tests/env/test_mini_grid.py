"""MiniGrid's own levels are rooms cell by cell: transitions, fewest actions, what hides what, in both engines."""

from __future__ import annotations

import dataclasses
from collections import deque

import gymnasium
import numpy as np
import pytest
import torch

import hrl_escape
from benchmarks.conformance import compare
from hrl_escape.checks import check_puzzle
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.mini_grid import HELD, PLACE_BITS, MiniGridConfig, MiniGridPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, ContractError, PlanningFailed, UnsupportedError
from hrl_escape.planning import RoomPlanner
from hrl_escape.planning.goals import parse_goal
from hrl_escape.planning.lower_bounds import LegBounds, bound_escape
from hrl_escape.planning.requests import PlanningRequest, bound_cost

pytest.importorskip("minigrid")
from minigrid.core.world_object import Ball, Door, Goal, Key  # noqa: E402  # only where MiniGrid is installed

from tests.env.isomorphism import GridOutcome, check_isomorphism

assert hrl_escape  # registers the environments

ACTIONS = ("turn-left", "turn-right", "forward", "grip", "release", "use")
"""Primitives that MiniGrid's left, right, forward, pickup, drop and toggle are."""
START = ">v<^"  # MiniGrid's directions; its rows count downwards


class Level:
    """One level of MiniGrid, by its own code; what doors have ever been opened is remembered beside it."""

    primitives = ACTIONS

    def __init__(self, name: str, seed: int, walk: int = 400) -> None:
        self.env = gymnasium.make(f"MiniGrid-{name}-v0").unwrapped
        self.env.reset(seed=seed)
        env, grid = self.env, self.env.grid
        self.width, self.height, self.walk = grid.width, grid.height, walk
        cells = [(i, j) for j in range(1, self.height - 1) for i in range(1, self.width - 1)]
        content = {cell: grid.get(*cell) for cell in cells}
        self.doors = [cell for cell in cells if isinstance(content[cell], Door)]
        self.things = [(cell, content[cell]) for kind in (Key, Ball) for cell in cells
                       if isinstance(content[cell], kind)]
        marks = {Goal: "G", Key: "k", Ball: "b"}

        def mark(cell):
            if cell == tuple(env.agent_pos):
                return START[env.agent_dir]
            thing = content[cell]
            if isinstance(thing, Door):
                return "D" if thing.is_locked else "d"
            return " " if thing is None else marks.get(type(thing), "#")

        self.rows = tuple("".join(mark((i, j)) for i in range(1, self.width - 1)) for j in range(1, self.height - 1))
        self.opened = [False] * len(self.doors)

    def read(self):
        """The level's state now."""
        doors = tuple((d.is_open, d.is_locked) for d in (self.env.grid.get(*cell) for cell in self.doors))
        carried = self.env.carrying
        things = tuple("held" if carried is thing else tuple(int(n) for n in thing.cur_pos)
                       for _, thing in self.things)
        opened = tuple(was or is_open for was, (is_open, _) in zip(self.opened, doors, strict=True))
        return tuple(int(n) for n in self.env.agent_pos), int(self.env.agent_dir), doors, things, opened

    def load(self, state):
        """Bring the level into a state."""
        at, direction, doors, things, opened = state
        env = self.env
        env.agent_pos, env.agent_dir, env.step_count, env.carrying = at, direction, 0, None
        self.opened = list(opened)
        for cell, (is_open, is_locked) in zip(self.doors, doors, strict=True):
            door = env.grid.get(*cell)
            door.is_open, door.is_locked = is_open, is_locked
        for _, thing in self.things:
            if min(thing.cur_pos) >= 0 and env.grid.get(*thing.cur_pos) is thing:
                env.grid.set(*thing.cur_pos, None)
        for (_, thing), place in zip(self.things, things, strict=True):
            if place == "held":
                env.carrying, thing.cur_pos = thing, np.array([-1, -1])
            else:
                env.grid.set(*place, thing)
                thing.cur_pos = np.array(place)

    def act(self, action):
        _, reward, terminated, _, _ = self.env.step(action)
        state = self.read()
        self.opened = list(state[-1])
        return state, reward, terminated

    def list_states(self):
        """States met by playing at random, more often towards what lies ahead."""
        rng, start = np.random.default_rng(0), self.read()
        found = {start: None}
        for _ in range(self.walk):
            before = self.read()
            ahead = self.env.grid.get(*self.env.front_pos)
            is_thing = ahead is not None and ahead.type in ("door", "key", "ball")
            odds = (1, 1, 1, 4, 1, 4) if is_thing else (1, 1, 4, 1, 1, 1)
            state, _, over = self.act(int(rng.choice(6, p=np.array(odds) / sum(odds))))
            if over:
                self.load(before)
            else:
                found[state] = None
        self.load(start)
        return list(found)

    def step(self, state, action, slip, chance):
        self.load(state)
        after, _, over = self.act(action)
        return GridOutcome(after, float(over), over)

    def encode(self, state):
        (column, row), direction, doors, things, opened = state
        columns, word = self.width - 2, 0
        for number, ((is_open, _), was) in enumerate(zip(doors, opened, strict=True)):
            word |= (is_open | was << 1) << 2 * number
        for number, place in enumerate(things):
            code = HELD if place == "held" else (place[1] - 1) * columns + place[0] - 1
            word |= code << 2 * len(doors) + PLACE_BITS * number
        return 2.0 * column - (self.width - 1), (self.height - 1) - 2.0 * row, word, -direction % 4

    def make_room(self, **changes):
        config = get_preset("door-key")
        return generate(dataclasses.replace(
            config, puzzle=MiniGridConfig("rows", rows=self.rows),
            room=dataclasses.replace(config.room, width=2.0 * (self.width - 2), depth=2.0 * (self.height - 2)),
            **changes), 0)

    def count_fewest(self):
        """Fewest actions to the end of the episode, breadth first over the level's own steps."""
        start = self.read()
        queue, known = deque([(start, 0)]), {start}
        while queue:
            state, count = queue.popleft()
            for action in range(6):
                self.load(state)
                after, _, over = self.act(action)
                if over:
                    return count + 1
                if after not in known:
                    known.add(after)
                    queue.append((after, count + 1))
        raise AssertionError("no way")


def find_fewest(room) -> int:
    """Fewest of MiniGrid's actions in the room, breadth first over the room's own steps."""
    rules = Kinematics(room)
    actions = [rules.actions.find(name) for name in ACTIONS]
    start = rules.make_state(room.starts[0])
    queue, known = deque([(start, 0)]), {(start.pose, start.puzzle)}
    while queue:
        state, count = queue.popleft()
        for action in actions:
            step = rules.step(state, action)
            if step.terminated:
                assert step.reward == 1.0
                return count + 1
            if (step.state.pose, step.state.puzzle) not in known:
                known.add((step.state.pose, step.state.puzzle))
                queue.append((step.state, count + 1))
    raise AssertionError("no way")


@pytest.mark.nightly_for("DoorKey-8x8-1", "KeyCorridorS3R3-2", "DoorKey-5x5-0", "KeyCorridorS3R2-0")
@pytest.mark.parametrize(("name", "seed"), [
    ("DoorKey-5x5", 0), ("DoorKey-8x8", 1), ("KeyCorridorS3R2", 0), ("KeyCorridorS3R3", 2), ("MultiRoom-N2-S4", 0)])
def test_rooms_are_minigrids_levels_transition_by_transition(name, seed):
    level = Level(name, seed)
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=level.make_room())
    assert check_isomorphism(env, level, pairs=600) > 200


@pytest.mark.parametrize(("name", "seed"), [("DoorKey-5x5", 3), ("DoorKey-6x6", 1), ("MultiRoom-N2-S4", 1)])
def test_the_fewest_actions_are_those_of_the_level(name, seed):
    level = Level(name, seed)
    assert find_fewest(level.make_room()) == level.count_fewest()


def test_a_key_that_opens_nothing_is_found_out():
    class Jammed(Level):
        def step(self, state, action, slip, chance):
            return super().step(state, 6 if action == 5 else action, slip, chance)

    level = Jammed("DoorKey-5x5", 0)
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=level.make_room()), level)


# --- generated levels ------------------------------------------------------------------------


def test_levels_of_a_batch_have_as_many_doors_each():
    rooms = [generate(get_preset("key-corridor"), seed) for seed in (0, 4)]
    assert [len(room.puzzle.grid.doors) for room in rooms] == [6, 7]
    with pytest.raises(UnsupportedError, match="make one batch for each"):
        TensorRoom(Rooms(2, instance=rooms))


LEVELS = [("door-key", {"size": 5}), ("door-key", {}), ("key-corridor", {}), ("multi-room", {"rooms": 3})]


@pytest.mark.nightly_for("multi-room-arguments3", "door-key-arguments1", "key-corridor-arguments2")
@pytest.mark.parametrize(("name", "arguments"), LEVELS)
def test_every_level_can_be_escaped_and_both_engines_agree(name, arguments):
    config = get_preset(name, **arguments)
    for seed in range(4):
        room = generate(config, seed)
        check_puzzle(room.puzzle, steps=40)
        rules = Kinematics(room)
        state = rules.make_state(room.starts[0])
        plan = RoomPlanner(room).solve(state)
        for primitive in plan.primitives:
            step = rules.step(state, primitive)
            state = step.state
        assert step.terminated and rules.has_escaped(state) and plan.compute_return() == 1.0
        assert plan.cost < room.horizon
    found = compare([room], 300, copies=10)
    assert not found.disagreements, found.disagreements[0]
    assert found.worst == 0.0


@pytest.mark.slow  # five seconds each: pytest -m slow tests/env/test_mini_grid.py
@pytest.mark.parametrize("name", ["door-key", "key-corridor", "multi-room", "dead-ends"])
def test_both_engines_agree_over_100_000_primitives(name):
    found = compare([generate(get_preset(name), 0)], 100_000, copies=500)
    assert found.primitives == 100_000 and not found.disagreements, found.disagreements[0]


@pytest.mark.nightly
def test_both_engines_agree_along_an_escape_and_on_what_is_seen():
    """Random play seldom opens a door: the plan does, and lidar looks through it."""
    room = generate(get_preset("key-corridor", size=3), 0)
    rules, batch = Kinematics(room), TensorRoom(Rooms(instance=room, observation="egocentric"), autoreset="disabled")
    observer = make_observer("egocentric", rules)
    batch.reset(torch.tensor([0]))
    state = batch.get_room_state(0)
    plan = RoomPlanner(room).solve(state)
    puzzles, ranges = set(), []
    for primitive in plan.primitives:
        seen = batch.observe()[0].numpy()
        assert np.abs(seen - observer.observe(state)).max() < 1e-5
        ranges.append(float(seen[-16:].max()))
        batch.step(torch.tensor([primitive]))
        state = rules.step(state, primitive).state
        assert batch.get_room_state(0) == state
        puzzles.add(state.puzzle)
    assert len(puzzles) >= 6 and rules.has_escaped(state)


def test_a_shut_door_hides_what_is_behind_it_and_an_open_one_does_not():
    room = generate(get_preset("multi-room", rooms=2, size=9), 1)
    observer = make_observer("egocentric", Kinematics(room))
    door = room.inner_doors[0]
    row = next(row for row in room.puzzle.map_rows if "d" in row)
    across = "#" in row[row.index("d") - 1: row.index("d")] and "#" in row[row.index("d") + 1: row.index("d") + 2]
    rules = Kinematics(room)
    place = {"x": door.x, "y": door.y + 2.0} if across else {"x": door.x - 2.0, "y": door.y}
    state = rules.make_state(room.starts[0])._replace(**place, heading_steps=0)
    shut, opened = (observer.observe(state._replace(puzzle=puzzle)) for puzzle in (0, 3))
    assert (opened[-16:] >= shut[-16:]).all() and opened[-16:].sum() > shut[-16:].sum()


def test_a_door_stops_the_robot_until_it_is_open_and_lets_it_out():
    room = generate(get_preset("door-key", size=5), 0)
    puzzle, rules = room.puzzle, Kinematics(room)
    assert isinstance(puzzle, MiniGridPuzzle)
    door = room.inner_doors[puzzle.grid.blockable.index(puzzle.grid.doors[0])]
    before = rules.make_state(room.starts[0])._replace(x=door.x - 2.0, y=door.y, heading_steps=0,
                                                       puzzle=puzzle._move(puzzle.make_state(), 0, HELD))
    forward, back, use = (rules.actions.find(name) for name in ("forward", "back", "use"))
    assert rules.step(before, forward).state.pose == before.pose
    after = rules.step(before, use).state
    assert puzzle.is_open(after.puzzle, 0) and not puzzle.is_open(rules.step(after, use).state.puzzle, 0)
    inside = rules.step(after, forward).state
    assert inside.x == door.x
    assert rules.step(inside._replace(puzzle=before.puzzle), forward).state.x == door.x + 2.0
    beside = inside._replace(x=door.x + 0.25, puzzle=before.puzzle)  # off its middle, where contact has a direction
    out = rules.step(beside, back).state
    assert out.x == door.x - 1.75
    batch = TensorRoom(Rooms(instance=room), autoreset="disabled")
    batch.reset(torch.tensor([0]))
    batch.set_room_state(0, beside)
    batch.step(torch.tensor([back]))
    assert batch.get_room_state(0) == out


def test_routes_are_remembered_by_the_doors_that_are_shut():
    room = generate(get_preset("multi-room", rooms=3), 0)
    number, door = next((n, room.inner_doors[n]) for n in (0, 1) if not room.puzzle.grid.list_doors_before(
        room.puzzle.grid.doors[n]))
    planner, goal = RoomPlanner(room), f"{door.x},{door.y}"
    shut = planner.rules.make_state(room.starts[0])
    with pytest.raises(PlanningFailed):
        planner.plan(shut, goal)
    assert planner.plan(shut._replace(puzzle=3 << 2 * number), goal).cost > 0, "the exit is shut in both"


@pytest.mark.nightly_for("key-corridor-0")
@pytest.mark.parametrize(("name", "seed"), [("door-key", 0), ("key-corridor", 0)])
def test_a_key_that_was_put_down_elsewhere_is_planned_for_where_it_lies(name, seed):
    """In every free cell that the room's own steps reach without the key, behind other doors, too."""
    room = generate(get_preset(name), seed)
    planner, puzzle = RoomPlanner(room), room.puzzle
    state = planner.rules.make_state(room.starts[0])
    locked = next(number for number in range(len(puzzle.grid.doors)) if puzzle.grid.is_locked(number))
    cells = [cell for cell in puzzle.grid.floor if cell not in puzzle.grid.bottlenecks
             and locked not in puzzle.grid.list_doors_before(cell)]
    assert len(cells) > 10
    for cell in cells:
        moved = state._replace(puzzle=puzzle._move(state.puzzle, 0, cell))
        plan = planner.solve(moved)
        assert planner.rules.has_escaped(plan.states[-1]) and bound_escape(room, moved) <= plan.cost


@pytest.fixture(scope="module")
def corridor():
    """A key at the far end of a corridor, with the door beside the start: a planner and the first state."""
    config = get_preset("door-key")
    room = generate(dataclasses.replace(
        config, puzzle=MiniGridConfig("rows", rows=(">      k", " D######", " G######")),
        room=dataclasses.replace(config.room, width=16.0, depth=6.0)), 0)
    planner = RoomPlanner(room)
    return planner, planner.rules.make_state(room.starts[0])


def move_near(planner, state):
    """The same state with the key beside the start."""
    puzzle = planner.instance.puzzle
    return state._replace(puzzle=puzzle._move(state.puzzle, 0, puzzle.grid.floor[0]))


def test_a_key_beside_the_start_makes_the_bound_no_higher_than_the_plan(corridor):
    """By its first place, far off behind a door, the bound would be above what an escape takes."""
    planner, state = corridor
    near = move_near(planner, state)
    far, cost = bound_escape(planner.instance, state), planner.solve(near).cost
    assert bound_escape(planner.instance, near) <= cost < far <= planner.solve(state).cost


@pytest.mark.parametrize("is_near", [False, True])
@pytest.mark.parametrize("words", [
    ("grip",), ("grip", "use"), ("grip", "use", "release"), ("grip", "release", "grip"),
    ("grip", "use", *("release", "grip", "use") * 3)])
def test_no_bound_of_goals_in_order_is_above_their_plan(corridor, words, is_near):
    """Wherever a thing lies, is carried or put down on the way, for each objective."""
    planner, state = corridor
    state = move_near(planner, state) if is_near else state
    goals = tuple(parse_goal(f"{word}-{'door-1' if word == 'use' else 'key-1'}", planner.instance) for word in words)
    bound = LegBounds(planner.instance).bound_goals(state, goals)
    for objective in ("primitives", "length"):
        request = PlanningRequest(state, goals, objective=objective)
        least = bound_cost(planner.instance, state, goals, request, bound)
        assert least <= planner.answer(request).cost
        assert is_near or least > 5, "the way to a key in its first place counts"
    assert bound >= len(goals), "each takes a primitive of its own"


@pytest.mark.parametrize("name", ["sokoban", "key-corridor"])
def test_no_bound_of_the_rest_of_an_escape_is_above_it(name):
    room = generate(get_preset(name), 1)
    planner = RoomPlanner(room)
    plan = planner.solve(planner.rules.make_state(room.starts[0]))
    bounds = LegBounds(room)
    for number, part in enumerate(plan.parts):
        goals = [later.goal for later in plan.parts[number:]]
        assert 0 < bounds.bound_goals(plan.states[part.start], goals) <= plan.cost - part.start


@pytest.mark.parametrize(("keys", "count"), [("k", None), ("kk", 2)])
def test_a_key_in_a_walled_off_cell_is_one_that_cannot_be_taken(keys, count):
    """Such a state can be made, though nothing leads to it; another key serves as well."""
    puzzle = MiniGridPuzzle((f">{keys}# ", f" D{' ' * (len(keys) - 1)}# ", f" G{' ' * (len(keys) - 1)}# "))
    cell = puzzle.grid.columns - 1
    away = puzzle._move(puzzle.make_state(), 0, cell)
    assert puzzle.is_state(away) and not puzzle.grid.can_reach(cell)
    found = puzzle.symbolic.plan(away)
    assert (found and len(found)) == count
    assert len(puzzle.symbolic.plan(puzzle.make_state())) == 2


def test_impossible_maps_are_refused():
    with pytest.raises(ConfigError, match="one start"):
        MiniGridPuzzle(("  ", "  "))
    with pytest.raises(ConfigError, match="a way from the start"):
        MiniGridPuzzle((">#k", "  #"))
    with pytest.raises(ConfigError, match="cells of 2 m"):
        generate(dataclasses.replace(get_preset("door-key"), puzzle=MiniGridConfig("rows", rows=(">D ",))), 0)
