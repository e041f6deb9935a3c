"""Isomorphism of a room and a published domain, transition by transition.

Each action of a `ReferenceDomain` is a press, run from a pose of the room to its end. What is equal then is the puzzle
after each press, from any pose: numbers of presses, state counts and learning curves in decisions carry over. Numbers
in primitives do not, for presses take different times. Each action of a `ReferenceGrid` is one primitive: then
everything carries over.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import gymnasium
import numpy as np

from hrl_escape.checks.claims import Claims
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import compute_noise, draw_chance
from hrl_escape.planning.goals import parse_goal
from hrl_escape.planning.planner import RoomPlanner

__all__ = ["GridOutcome", "ReferenceDomain", "ReferenceGrid", "check_isomorphism"]


class ReferenceDomain(Protocol):
    """A published domain: states, what actions do, and which puzzle state each of its states is."""

    def list_states(self) -> Iterable[Hashable]:
        """All states in which the task is not over."""
        ...

    def step(self, state: Any, action: int, uniform: float = 0.0, /) -> Hashable:
        """The state after an action; action i presses target i of the room, or reaches goal i of those that are given.

        A random domain turns the uniform number, which is the room's own, into the outcome; others need not take it.
        """
        ...

    def is_over(self, state: Any) -> bool:
        """Say whether the task is done, or failed."""
        ...

    def encode(self, state: Any) -> Hashable:
        """The puzzle's state that stands for this one."""
        ...


class GridOutcome(NamedTuple):
    """Result of an action of a grid world.

    Attributes:
        state: the state after it.
        reward: its reward.
        is_over: the episode has ended.
    """

    state: Hashable
    reward: float
    is_over: bool


@runtime_checkable
class ReferenceGrid(Protocol):
    """A published grid world, each action of which is a primitive of the room.

    Attributes:
        primitives: name of the primitive that each action is.
    """

    primitives: Sequence[str]

    def list_states(self) -> Iterable[Hashable]:
        """All states in which the episode is not over."""
        ...

    def step(self, state: Any, action: int, slip: float, chance: float, /) -> GridOutcome:
        """The outcome of an action, by the room's own uniform numbers for slips and for its puzzle."""
        ...

    def encode(self, state: Any) -> tuple[float, float, Hashable] | tuple[float, float, Hashable, int]:
        """Place of the robot, m, and state of the puzzle that stand for this one.

        Where actions turn, its heading is the fourth, in turn steps; elsewhere it is the start's and stays.
        """
        ...


def check_isomorphism(env: gymnasium.Env, reference: ReferenceDomain | ReferenceGrid, pairs: int = 10_000,
                      seed: int = 0, goals: Sequence[str] | None = None) -> int:
    """Check that pressing in a room, or its primitives, do what the actions of a domain do.

    Each pair of state and press is tried from the start and from the target's own panel, to which the robot must then
    come back, and so is each goal that is given; where an option to a goal may not begin, the domain's action must do
    nothing. Of a grid world, each primitive is tried at the heading of the start, or of the state where that tells
    one, and rewards are compared too. In a random room, both take the same uniform numbers.

    Args:
        env: a flat environment of a kinematic room, such as `gymnasium.make("hrl_escape/Hanoi-v1")`.
        reference: the domain.
        pairs: largest number of pairs that are tried; of more, so many are drawn.
        seed: of that draw.
        goals: texts of the goals that a domain's actions are, such as `grip-place-a`; None where action i presses
            target i.

    Returns:
        Number of pairs tried.

    Raises:
        ContractError: the first transition that differs.
        PlanningFailed: a target cannot be pressed.
    """
    rng = np.random.default_rng(seed)
    if isinstance(reference, ReferenceGrid):
        return _GridCheck(env, reference).run(pairs, rng)
    return _IsomorphismCheck(env, reference, goals).run(pairs, rng)


class _GridCheck(Claims):
    """The primitives of one room beside the actions of one grid world."""

    def __init__(self, env: gymnasium.Env, reference: ReferenceGrid) -> None:
        self.env, self.reference = env, reference
        self.room: Any = env.unwrapped
        super().__init__(f"puzzle {self.room.instance.puzzle.kind!r}")
        self.actions = [self.room.rules.actions.find(name) for name in reference.primitives]

    def run(self, most: int, rng: np.random.Generator) -> int:
        states = list(self.reference.list_states())
        codes = [self.reference.encode(state) for state in states]
        self.require(len(set(codes)) == len(states), "different states have different codes", len(set(codes)))
        tried = rng.permutation(len(states) * len(self.actions))[:most].tolist()
        self.env.reset(seed=0)
        start = self.room.get_state()
        for key, number in enumerate(sorted(tried)):
            place, action = divmod(number, len(self.actions))
            x, y, puzzle, heading = self.read(codes[place], start)
            touching = self.room.rules.compute_touching(x, y, heading, *start.pose[3:])
            begin = start._replace(x=x, y=y, puzzle=puzzle, heading_steps=heading, primitives=0, noise_key=key,
                                   touching=touching)
            self.try_pair(states[place], action, begin)
        return len(tried)

    @staticmethod
    def read(code: tuple, start: RoomState) -> tuple[float, float, Hashable, int]:
        """Place, puzzle and heading of a code."""
        x, y, puzzle, *heading = code
        return x, y, puzzle, heading[0] if heading else start.heading_steps

    def try_pair(self, state: Any, action: int, begin: RoomState) -> None:
        """Run one primitive in room and reference, and require the same outcome of both."""
        self.room.set_state(begin)
        _, reward, terminated, _, _ = self.env.step(self.actions[action])
        ended = self.room.get_state()
        slip, chance = compute_noise(begin.noise_key, 0)[1], draw_chance(begin.noise_key, 0)
        after = self.reference.step(state, action, slip, chance)
        seen = (ended.x, ended.y, ended.puzzle, ended.heading_steps)
        self.require(seen == self.read(self.reference.encode(after.state), begin),
                     "a primitive does what the action does", (state, action, seen))
        self.require(float(reward) == after.reward, "both earn the same", (state, action, reward, after.reward))
        self.require(terminated == after.is_over, "both are over, or neither", (state, action))


class _IsomorphismCheck(Claims):
    """The transitions of one room beside those of one domain."""

    def __init__(self, env: gymnasium.Env, reference: ReferenceDomain, goals: Sequence[str] | None) -> None:
        self.env, self.reference = env, reference
        self.room: Any = env.unwrapped
        self.puzzle = self.room.instance.puzzle
        texts = [f"press-{name}" for name in self.puzzle.target_names] if goals is None else goals
        self.goals = [parse_goal(text, self.room.instance) for text in texts]
        super().__init__(f"puzzle {self.puzzle.kind!r}")
        self.planner = RoomPlanner(self.room.instance)

    def run(self, most: int, rng: np.random.Generator) -> int:
        states = list(self.reference.list_states())
        codes = [self.reference.encode(state) for state in states]
        self.require(len(set(codes)) == len(states), "different states have different codes", len(set(codes)))
        tried = rng.permutation(len(states) * len(self.goals))[:most].tolist()
        self.env.reset(seed=0)
        start = self.room.get_state()
        for number in sorted(tried):
            place, action = divmod(number, len(self.goals))
            self.try_pair(states[place], action, start._replace(puzzle=codes[place]))
        return len(tried)

    def try_pair(self, state: Any, action: int, start: RoomState) -> None:
        """Press once from the start, and once more from where that ended, in the same state of the puzzle."""
        self.require(self.is_over(start) == self.reference.is_over(state), "both are over, or neither", state)
        if not self.planner.routes.can_start(start, self.goals[action]):
            self.require(self.reference.step(state, action) == state, "an action that cannot begin does nothing",
                         (state, action))
            return
        ended = self.press(action, start)
        after = self.follow(state, action, ended)
        self.require(ended.puzzle == self.reference.encode(after), "a press does what the action does",
                     (state, action, ended.puzzle))
        self.require(self.is_over(ended) == self.reference.is_over(after), "both are over, or neither", after)
        again = self.press(action, ended._replace(puzzle=start.puzzle, primitives=0))
        expected = self.reference.encode(self.follow(state, action, again))
        self.require(again.puzzle == expected, "so it does from the target's own panel", (state, action, again.puzzle))

    def is_over(self, state: RoomState) -> bool:
        """The exit is open, or the puzzle was failed."""
        return self.puzzle.is_solved(state.puzzle) or self.puzzle.is_failed(state.puzzle)

    def follow(self, state: Any, action: int, ended: RoomState) -> Any:
        """The domain's state after an action, by the uniform number of the primitive that pressed in the room."""
        if not self.puzzle.is_random:
            return self.reference.step(state, action)
        return self.reference.step(state, action, draw_chance(ended.noise_key, ended.primitives - 1))

    def press(self, action: int, start: RoomState) -> RoomState:
        """State of the room after the plan to press a target was carried out."""
        plan = self.planner.plan(start, self.goals[action])
        self.room.set_state(start)
        for primitive in plan.primitives:
            self.env.step(primitive)
        return self.room.get_state()
