"""Sokoban and Key-Chest are rooms cell by cell: transitions, rewards, fewest moves, values, dead ends, both engines."""

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
from hrl_escape.env.noise import compute_noise
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.sokoban import (
    PUSH_SIDES,
    BoxMap,
    SokobanConfig,
    SokobanPuzzle,
    draw_level,
    find_fewest_shoves,
    read_boxoban,
    tidy_level,
)
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, ContractError, GenerationError, PlanningFailed
from hrl_escape.options import OptionsEnv
from hrl_escape.planning import RoomPlanner
from tests.env.isomorphism import GridOutcome, check_isomorphism
from tests.env.test_grid_worlds import find_keys, iterate_values

assert hrl_escape  # registers the environments

MOVES = ("strafe-left", "strafe-right", "back", "forward")
"""Primitives at heading 0 that are up, down, left, right."""
STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))

MICROBAN = {  # David W. Skinner's Microban, levels 1 and 2, with the fewest moves that are known for them
    33: ("####", "# .#", "#  ###", "#*@  #", "#  $ #", "#  ###", "####"),
    16: ("######", "#    #", "# #@ #", "# $* #", "# .* #", "#    #", "######"),
}
BOXOBAN = """; 0
##########
#        #
# $  #   #
#  @ # . #
# .  ### #
##########

; 1
######
#@$ .#
######
"""


class Sokoban:
    """Rules of Sokoban over rows and columns, with the rewards of gym-sokoban."""

    primitives = MOVES

    def __init__(self, rows: tuple[str, ...]) -> None:
        self.rows = rows
        cells = {(i, j): c for i, row in enumerate(rows) for j, c in enumerate(row)}
        self.floor = {cell for cell, c in cells.items() if c != "#"}
        self.goals = {cell for cell, c in cells.items() if c in ".*+"}
        player = next(cell for cell, c in cells.items() if c in "@+")
        self.start = player, tuple(cell for cell, c in cells.items() if c in "$*")

    def move(self, state, action):
        (row, column), boxes = state
        down, right = STEPS[action]
        to, beyond = (row + down, column + right), (row + 2 * down, column + 2 * right)
        if to not in self.floor or (to in boxes and (beyond not in self.floor or beyond in boxes)):
            return state
        return to, tuple(beyond if box == to else box for box in boxes)

    def count_filled(self, state):
        return len(self.goals.intersection(state[1]))

    def step(self, state, action, slip, chance):
        after = self.move(state, action)
        more, is_over = self.count_filled(after) - self.count_filled(state), self.count_filled(after) == len(self.goals)
        return GridOutcome(after, (-0.1 + 10.0 if is_over else -0.1) + more, is_over)

    def list_states(self, most=400):
        """States in the order in which play comes to them."""
        known, queue = {self.start}, deque([self.start])
        while queue and len(known) < most:
            state = queue.popleft()
            for after in (self.move(state, action) for action in range(4)):
                if after not in known and self.count_filled(after) < len(self.goals):
                    known.add(after)
                    queue.append(after)
        return list(known)

    def count_fewest(self):
        """Fewest moves of a solution, breadth first; None if there is none."""
        queue, known = deque([(self.start, 0)]), {self.start}
        while queue:
            state, count = queue.popleft()
            if self.count_filled(state) == len(self.goals):
                return count
            for after in (self.move(state, action) for action in range(4)):
                if after not in known:
                    known.add(after)
                    queue.append((after, count + 1))
        return None

    def encode(self, state):
        (row, column), boxes = state
        wide, side = len(self.rows[0]), 2.0 if min(len(self.rows), len(self.rows[0])) > 2 else 5.0
        word = sum((i * wide + j) << 8 * number for number, (i, j) in enumerate(boxes))
        return side * (column - (wide - 1) / 2), side * ((len(self.rows) - 1) / 2 - row), word


# --- Sokoban ------------------------------------------------------------------------------


@pytest.mark.parametrize("fewest", MICROBAN)
def test_a_room_is_sokoban_move_by_move_and_its_plans_have_the_fewest_moves(fewest):
    room = generate(get_preset("sokoban", rows=MICROBAN[fewest]), 0)
    level = Sokoban(room.puzzle.rows)
    assert check_isomorphism(gymnasium.make("hrl_escape/Sokoban-v1", instance=room), level, pairs=400) == 400
    assert level.count_fewest() == fewest
    rules = Kinematics(room)
    plan = RoomPlanner(room).solve(rules.make_state(room.starts[0]))
    assert plan.cost == fewest and rules.has_escaped(plan.states[-1])
    filled = level.count_filled(level.start)
    assert plan.compute_return() == pytest.approx(-0.1 * fewest + 10 + len(level.goals) - filled)


def test_a_box_that_does_not_move_is_found_out():
    class Stuck(Sokoban):
        def move(self, state, action):
            after = super().move(state, action)
            return after if after[1] == state[1] else state

    room = generate(get_preset("sokoban", rows=MICROBAN[16]), 0)
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(gymnasium.make("hrl_escape/Sokoban-v1", instance=room), Stuck(room.puzzle.rows))


@pytest.mark.nightly
def test_drawn_levels_are_certified_and_escaped_by_the_fewest_moves():
    """Small ones, so that breadth-first search over their own rules is quick."""
    for seed in range(12):
        room = generate(get_preset("sokoban", size=5), seed)
        rules = Kinematics(room)
        plan = RoomPlanner(room).solve(rules.make_state(room.starts[0]))
        assert rules.has_escaped(plan.states[-1])
        assert plan.cost == Sokoban(room.puzzle.rows).count_fewest()


@pytest.mark.nightly
def test_the_search_finds_the_fewest_moves_or_that_there_are_none():
    rng, solvable = np.random.default_rng(0), 0
    for _ in range(120):
        cells = rng.choice([" ", " ", " ", "#"], 25)
        places = rng.permutation(25)[:5]
        cells[places] = list("@$$..")
        rows = tuple("".join(cells[begin: begin + 5]) for begin in range(0, 25, 5))
        level, fewest = BoxMap(rows), Sokoban(rows).count_fewest()
        found = find_fewest_shoves(rows, level.start, frozenset(level.boxes))
        assert (found is None) == (fewest is None), rows
        if found is not None:
            moves, player, boxes = 0, level.start, frozenset(level.boxes)
            for shove in found:
                side = list(PUSH_SIDES).index(shove.side)
                moves += level.measure_walks(player, boxes)[level.find_beside(shove.cell, side ^ 2)] + 1
                player, boxes = shove.cell, boxes - {shove.cell} | {level.find_beside(shove.cell, side)}
            assert moves == fewest and boxes == frozenset(level.goals)
            solvable += 1
    assert solvable > 10


@pytest.mark.parametrize("config", [SokobanConfig(5, 1), SokobanConfig(6, 2), SokobanConfig(rows=MICROBAN[33])])
def test_the_rules_keep_the_contract(config):
    check_puzzle(config.make_puzzle(np.random.default_rng(0)), steps=60)


@pytest.mark.nightly_for("6-4")
@pytest.mark.parametrize(("size", "boxes"), [(5, 2), (6, 4)])
def test_both_engines_agree_where_boxes_are_pushed(size, boxes):
    rooms = [generate(get_preset("sokoban", size=size, boxes=boxes), seed) for seed in range(3)]
    found = compare(rooms, 1000, copies=50)
    assert not found.disagreements, found.disagreements[0]
    assert found.worst == 0.0


@pytest.mark.nightly
def test_both_engines_agree_along_an_escape():
    room = generate(get_preset("sokoban", rows=MICROBAN[33]), 0)
    rules, batch = Kinematics(room), TensorRoom(Rooms(instance=room), autoreset="disabled")
    batch.reset(torch.tensor([0]))
    state, puzzles = batch.get_room_state(0), set()
    for primitive in RoomPlanner(room).solve(state).primitives:
        outcome, step = batch.step(torch.tensor([primitive])), rules.step(state, primitive)
        state = step.state
        assert batch.get_room_state(0) == state and bool(outcome.terminated) == step.terminated
        assert outcome.reward.item() == pytest.approx(step.reward, abs=1e-6)
        puzzles.add(state.puzzle)
    assert rules.has_escaped(state) and len(puzzles) == 1 + 8


def test_levels_that_cannot_be_solved_are_not_certified():
    with pytest.raises(GenerationError, match="solvable by pushes"):
        generate(get_preset("sokoban", rows=("$   ", " @  ", "   .")), 0)


def test_from_a_dead_end_the_planner_says_so():
    room = generate(get_preset("sokoban", rows=("    ", "@$ .", "    ")), 0)
    rules, puzzle = Kinematics(room), room.puzzle
    assert isinstance(puzzle, SokobanPuzzle)
    state = rules.make_state(room.starts[0])
    assert RoomPlanner(room).solve(state).cost == 2
    with pytest.raises(PlanningFailed):
        RoomPlanner(room).solve(state._replace(puzzle=puzzle.encode((0,))))


def test_meta_actions_push_one_box_one_cell_and_are_masked_where_it_is_stuck():
    room = generate(get_preset("sokoban", rows=("    ", " $ .", "@   ")), 0)
    env = OptionsEnv(gymnasium.make("hrl_escape/Sokoban-v1", instance=room), include_primitives=False)
    _, info = env.reset(seed=0)
    assert [option.about for option in env.options[:-1]] == ["box-1"] * 4 and info["action_mask"][:4].all()
    for side, (down, right) in enumerate(PUSH_SIDES.values()):
        env.reset(seed=0)
        *_, info = env.step(side)
        assert info["option"]["ended"] == "reached"
        assert divmod(env.unwrapped.get_state().puzzle, 4) == (1 + down, 1 + right)
    env.reset(seed=0)
    *_, info = env.step(1)  # north, to the wall
    assert info["action_mask"][:4].tolist() == [1, 0, 1, 0]


def test_two_boxes_in_exchanged_cells_have_routes_of_their_own():
    room = generate(get_preset("sokoban", rows=("     ", " $ $ ", "@ . .", "     ")), 0)
    rules, puzzle = Kinematics(room), room.puzzle
    planner, state = RoomPlanner(room), rules.make_state(room.starts[0])
    exchanged = state._replace(puzzle=puzzle.encode(puzzle.decode(state.puzzle)[::-1]))
    first, second = (planner.plan(begin, "push-south-box-1") for begin in (state, exchanged))
    assert first.states[-1].x != second.states[-1].x


def test_boxobans_files_are_read():
    first, second = read_boxoban(BOXOBAN)
    assert len(first) == 6 and tidy_level(second) == ("@$ .",)
    with pytest.raises(ConfigError, match="as many boxes"):
        tidy_level(first)
    with pytest.raises(ConfigError, match="Boxoban"):
        read_boxoban("; 0\n")
    with pytest.raises(ConfigError, match="player can reach"):
        tidy_level(("#####", "#@#$#", "#.###", "#####"))
    with pytest.raises(ConfigError, match="one player"):
        SokobanPuzzle(("  $.",))


def test_outside_of_the_walls_is_no_floor():
    assert tidy_level(MICROBAN[33]) == (" .##", "  ##", "*@  ", "  $ ", "  ##")
    assert len(draw_level(6, 3, np.random.default_rng(1))) == 6


def test_pushing_needs_robots_that_stay_on_the_lattice():
    config = get_preset("sokoban")
    for change in ({"blocked": "contact"}, {"noise": 0.1}):
        with pytest.raises(ConfigError, match="no noise where things are pushed"):
            generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, **change)), 0)


# --- Key-Chest ----------------------------------------------------------------------------

HRAC = """\
wwwwwwwwwwwwwwwww
w               w
wB              w
wwwwwwwwwwwwww  w
w               w
w               w
wK wwwwwwwwwww  w
w               w
w               w
wwwwwwwwwwwwww  w
w               w
w      S        w
wwwwwwwwwwwwwwwww"""
"""The layout in HRAC's program (trzhang0116/HRAC at b94b8c0, discrete/env.py)."""


class KeyChest:
    """Rules of HRAC's program; a quarter of the moves is drawn from all four."""

    primitives = MOVES

    def __init__(self) -> None:
        cells = {(i, j): c for i, row in enumerate(HRAC.splitlines()) for j, c in enumerate(row)}
        self.walls = {cell for cell, c in cells.items() if c == "w"}
        self.start, self.key, self.chest = (next(cell for cell, c in cells.items() if c == mark) for mark in "SKB")
        self.cells = [cell for cell in cells if cell not in self.walls]

    def list_states(self):
        return [(cell, has_key) for cell in self.cells for has_key in (0, 1) if (cell, has_key) != (self.chest, 1)]

    def move(self, state, action):
        (row, column), has_key = state
        down, right = STEPS[action]
        to = row + down, column + right
        if to in self.walls:
            return GridOutcome(state, 0.0, False)
        if to == self.key and not has_key:
            return GridOutcome((to, 1), 1.0, False)
        opens = to == self.chest and has_key == 1
        return GridOutcome((to, 2 if opens else has_key), 5.0 if opens else 0.0, opens)

    def step(self, state, action, slip, chance):
        order = [3, 2, 0, 1]  # actions by the room's numbers: forward, back, strafe left, strafe right
        others = [other for other in order if other != action]
        return self.move(state, others[int(slip / (3 / 16) * 3)] if slip < 3 / 16 else action)

    def encode(self, state):
        (row, column), has_key = state
        return column - 8.0, 6.0 - row, has_key


@pytest.mark.nightly
def test_a_room_is_hracs_key_chest_move_by_move():
    env = gymnasium.make("hrl_escape/KeyChest-v1", instance=generate(get_preset("key-chest", random_start=True), 0))
    domain = KeyChest()
    assert check_isomorphism(env, domain) == len(domain.list_states()) * 4
    rooms = [generate(get_preset("key-chest", random_start=is_random), 0) for is_random in (False, True)]
    starts = [{(start.x, start.y) for start in room.starts} for room in rooms]
    assert starts == [{domain.encode((domain.start, 0))[:2]}, {domain.encode((cell, 0))[:2] for cell in domain.cells}]


@pytest.mark.nightly
def test_key_chest_has_the_domains_values():
    """Best discounted return by both models; each slip is drawn by the room's own numbers."""
    room, domain = generate(get_preset("key-chest", random_start=True), 0), KeyChest()
    rules, states = Kinematics(room), domain.list_states()
    numbers = {domain.encode(state): number for number, state in enumerate(states)}
    keys = find_keys((np.arange(17) / 16).tolist(), lambda key: compute_noise(key, 0)[1])
    actions = [rules.actions.find(name) for name in MOVES]
    base, ours, theirs = rules.make_state(room.starts[0]), [], []
    for state in states:
        x, y, puzzle = domain.encode(state)
        begin = base._replace(x=x, y=y, puzzle=puzzle, touching=rules.compute_touching(x, y, 0, 0.0, (), ()))
        steps = [[rules.step(begin._replace(noise_key=key), action) for key in keys] for action in actions]
        ours.append([[(1 / 16, numbers.get((s.state.x, s.state.y, s.state.puzzle), 0), s.reward, s.terminated)
                      for s in row] for row in steps])
        theirs.append([[(0.75 * (other == action) + 1 / 16, numbers.get(domain.encode(done.state), 0), done.reward,
                         done.is_over) for other in range(4) for done in [domain.move(state, other)]]
                       for action in range(4)])
    mine, published = iterate_values(ours, 0.99), iterate_values(theirs, 0.99)
    assert np.abs(mine - published).max() < 1e-10
    assert 3.0 < mine[numbers[domain.encode((domain.start, 0))]] < 6.0


@pytest.mark.nightly
def test_both_engines_agree_on_key_chest_and_the_planner_takes_the_fewest_moves():
    room = generate(get_preset("key-chest"), 0)
    check_puzzle(room.puzzle)
    found = compare([generate(get_preset("key-chest", random_start=True), 0)], 2000, copies=100)
    assert not found.disagreements, found.disagreements[0]
    plan = RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0]))
    domain, queue, known = KeyChest(), deque([((KeyChest().start, 0), 0)]), set()
    while queue:
        state, count = queue.popleft()
        outcomes = [domain.move(state, action) for action in range(4)]
        if any(outcome.is_over for outcome in outcomes):
            break
        fresh = {outcome.state for outcome in outcomes} - known
        known |= fresh
        queue.extend((after, count + 1) for after in fresh)
    assert plan.cost == count + 1 and plan.compute_return() == 6.0
