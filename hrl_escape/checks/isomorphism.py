"""Isomorphism of a room and a published domain, transition by transition.

Each action of the domain is a press, run from a pose of the room to its end. What is equal then is the puzzle after
each press, from any pose: numbers of presses, state counts and learning curves in decisions carry over. Numbers in
primitives do not, for presses take different times.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, Protocol

import gymnasium
import numpy as np

from hrl_escape.checks.claims import Claims
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import draw_chance
from hrl_escape.planning.room_planner import RoomPlanner

__all__ = ["ReferenceDomain", "check_isomorphism"]


class ReferenceDomain(Protocol):
    """A published domain: states, what actions do, and which puzzle state each of its states is."""

    def list_states(self) -> Iterable[Hashable]:
        """All states in which the task is not over."""
        ...

    def step(self, state: Any, action: int, uniform: float = 0.0, /) -> Hashable:
        """The state after an action; action i presses target i of the room.

        A random domain turns the uniform number, which is the room's own, into the outcome; others need not take it.
        """
        ...

    def is_over(self, state: Any) -> bool:
        """Say whether the task is done, or failed."""
        ...

    def encode(self, state: Any) -> Hashable:
        """The puzzle's state that stands for this one."""
        ...


def check_isomorphism(env: gymnasium.Env, reference: ReferenceDomain, pairs: int = 10_000, seed: int = 0) -> int:
    """Check that pressing in a room does what the actions of a domain do.

    Each pair of state and action is tried from the start and from the target's own panel, to which the robot must then
    come back. In a random room, both take the same uniform number.

    Args:
        env: a flat environment of a kinematic room, such as `gymnasium.make("hrl_escape/Hanoi-v1")`.
        reference: the domain.
        pairs: largest number of pairs that are tried; of more, so many are drawn.
        seed: of that draw.

    Returns:
        Number of pairs tried.

    Raises:
        ContractError: the first transition that differs.
        PlanningFailed: a target cannot be pressed.
    """
    return _IsomorphismCheck(env, reference).run(pairs, np.random.default_rng(seed))


class _IsomorphismCheck(Claims):
    """The transitions of one room beside those of one domain."""

    def __init__(self, env: gymnasium.Env, reference: ReferenceDomain) -> None:
        self.env, self.reference = env, reference
        self.room: Any = env.unwrapped
        self.puzzle = self.room.instance.puzzle
        super().__init__(f"puzzle {self.puzzle.kind!r}")
        self.planner = RoomPlanner(self.room.instance)

    def run(self, most: int, rng: np.random.Generator) -> int:
        states = list(self.reference.list_states())
        codes = [self.reference.encode(state) for state in states]
        self.require(len(set(codes)) == len(states), "different states have different codes", len(set(codes)))
        targets = len(self.puzzle.target_names)
        tried = rng.permutation(len(states) * targets)[:most].tolist()
        self.env.reset(seed=0)
        start = self.room.get_state()
        for number in sorted(tried):
            place, action = divmod(number, targets)
            self.try_pair(states[place], action, start._replace(puzzle=codes[place]))
        return len(tried)

    def try_pair(self, state: Any, action: int, start: RoomState) -> None:
        """Press once from the start, and once more from where that ended, in the same state of the puzzle."""
        self.require(self.is_over(start) == self.reference.is_over(state), "both are over, or neither", state)
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
        plan = self.planner.plan(start, self.puzzle.target_names[action])
        self.room.set_state(start)
        for primitive in plan.primitives:
            self.env.step(primitive)
        return self.room.get_state()
