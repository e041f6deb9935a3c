"""Rooms against published domains that know nothing of rooms, and against such with one planted difference."""

import itertools

import gymnasium
import numpy as np
import pytest

import hrl_escape
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.codes import CodeLockConfig
from hrl_escape.env.puzzles.factored import FactoredConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.light_box import LightBoxConfig
from hrl_escape.env.puzzles.lights_out import LightsOutConfig
from hrl_escape.errors import ContractError
from tests.env.isomorphism import check_isomorphism

assert hrl_escape  # registers the environments


class Hanoi:
    """Pegs as tuples of discs, largest first, and the disc in the hand or None."""

    def list_states(self):
        for places in itertools.product(range(3), repeat=3):
            yield tuple(tuple(d for d in (2, 1, 0) if places[d] == peg) for peg in range(3)), None

    def step(self, state, action):
        pegs, hand = [list(peg) for peg in state[0]], state[1]
        if hand is None and pegs[action]:
            hand = pegs[action].pop()
        elif hand is not None and (not pegs[action] or pegs[action][-1] > hand):
            pegs[action].append(hand)
            hand = None
        return tuple(map(tuple, pegs)), hand

    def is_over(self, state):
        return state == (((), (), (2, 1, 0)), None)

    def encode(self, state):
        pegs, hand = state
        places = [3 if disc == hand else next(i for i, peg in enumerate(pegs) if disc in peg) for disc in range(3)]
        return sum(1 << 4 * disc + place for disc, place in enumerate(places))


class Board:
    """OGBench's board of 3 x 3, its first task, as an array of 0 and 1."""

    goal = (1, 1, 0, 1, 0, 1, 0, 1, 1)

    def list_states(self):
        return itertools.product((0, 1), repeat=9)

    def step(self, state, action):
        board = np.array(state).reshape(3, 3)
        for i, j in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            row, column = action // 3 + i, action % 3 + j
            if 0 <= row < 3 and 0 <= column < 3:
                board[row, column] = (board[row, column] + 1) % 2
        return tuple(board.ravel().tolist())

    def is_over(self, state):
        return state == self.goal

    def encode(self, state):
        return sum(on << i for i, on in enumerate(state))


class Wrapping(Board):
    """A board whose rows have no ends."""

    def step(self, state, action):
        left = 3 * (action // 3) + (action - 1) % 3
        after = list(super().step(state, action))
        if action % 3 == 0:
            after[left] ^= 1
        return tuple(after)


def make_env(puzzle):
    return gymnasium.make("hrl_escape/EscapeRoom-v1", config=RoomConfig(
        puzzle=puzzle, robot=RobotConfig(body_radius=0.4), room=ShapeConfig(width=12, depth=12)))


def test_the_towers_of_hanoi_are_those_of_three_stacks():
    assert check_isomorphism(gymnasium.make("hrl_escape/Hanoi-v1"), Hanoi()) == 27 * 3


def test_lights_out_is_ogbenchs_board():
    env = make_env(LightsOutConfig(task=1))
    assert check_isomorphism(env, Board(), pairs=150) == 150
    with pytest.raises(ContractError, match="a press does what the action does"):
        check_isomorphism(env, Wrapping(), pairs=150)


def test_another_goal_is_another_domain():
    env = make_env(LightsOutConfig(task=2))
    with pytest.raises(ContractError, match="both are over, or neither"):
        check_isomorphism(env, Board(), pairs=10_000)


def test_a_lock_is_its_state_machine():
    env = make_env(CodeLockConfig())
    code = env.unwrapped.instance.puzzle.code

    class Lock:
        def list_states(self):
            return range(4)

        def step(self, state, action):
            return state + 1 if code[state] == action else 0

        def is_over(self, state):
            return state == 4

        def encode(self, state):
            return state

    assert check_isomorphism(env, Lock()) == 16


class Box:
    """Six lights in two rows, each of the second on two of the first; a press fails once in four times."""

    parents = ((), (), (), (0, 1), (1, 2), (3, 4))

    def list_states(self):
        for on in itertools.product((False, True), repeat=6):
            if all(not on[i] or all(on[j] for j in parents) for i, parents in enumerate(self.parents)):
                yield on

    def step(self, state, action, uniform):
        on = list(state)
        if uniform >= 0.75:
            return state
        if not on[action] and not all(on[i] for i in self.parents[action]):
            return (False,) * 6
        on[action] = not on[action]
        for light, parents in enumerate(self.parents):
            on[light] = on[light] and all(on[i] for i in parents)
        return tuple(on)

    def is_over(self, state):
        return state[5]

    def encode(self, state):
        return sum(on << i for i, on in enumerate(state))


class Factors:
    """Digits that turn by tables; the last number says which states are left out, as nothing leads to them."""

    def __init__(self, puzzle):
        self.puzzle = puzzle
        self.tables = [np.reshape(turns, (3,) * (len(parents) + 1))
                       for parents, turns in zip(puzzle.parents, puzzle.turns, strict=True)]

    def list_states(self):
        states = itertools.product(range(3), repeat=3)
        return [state for state in states if self.puzzle.is_state(self.encode(state))]

    def step(self, state, action, uniform):
        values = list(state)
        parents = reversed(self.puzzle.parents[action])
        if uniform < 0.9:
            values[action] = int(self.tables[action][(*(state[other] for other in parents), state[action])])
        return tuple(values)

    def is_over(self, state):
        return self.encode(state) == self.puzzle.goal

    def encode(self, state):
        return state[0] + 3 * state[1] + 9 * state[2]


def test_a_random_domain_is_its_tables():
    env = make_env(FactoredConfig(count=3))
    domain = Factors(env.unwrapped.instance.puzzle)
    assert check_isomorphism(env, domain) == 3 * len(domain.list_states()) > 30
    domain.tables[0] = domain.tables[0][..., ::-1]
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(env, domain)


class Lucky(Box):
    def step(self, state, action, uniform):
        return super().step(state, action, uniform / 2)


def test_a_random_domain_takes_the_rooms_own_chances():
    edges = tuple((parent, child) for child, parents in enumerate(Box.parents) for parent in parents)
    env = make_env(LightBoxConfig(count=6, graph=GraphConfig(kind="edges", edges=edges), success=0.75))
    assert check_isomorphism(env, Box()) == 6 * len(list(Box().list_states()))
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(env, Lucky())


class Sea:
    """Three rows of a deep sea: (row, column), and "treasure" where it was found."""

    meaning = np.random.RandomState(42).binomial(1, 0.5, [3, 3])

    def list_states(self):
        return [(row, column) for row in range(3) for column in range(row + 1)]

    def step(self, state, action):
        row, column = state
        if action != self.meaning[row, column]:
            return row + 1, max(column - 1, 0)
        return "treasure" if column == 2 else (row + 1, column + 1)

    def is_over(self, state):
        return state == "treasure" or state[0] == 3

    def encode(self, state):
        return 1 << 12 | 3 << 6 | 2 if state == "treasure" else state[0] << 6 | state[1]


def test_a_dive_that_fails_is_over():
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", config=get_preset("deep-sea", size=3))
    assert check_isomorphism(env, Sea()) == 12
