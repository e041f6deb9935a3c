"""`Escapes`: legs planned jointly with the rest of the escape, in rooms where that is fast.

`search/joint_search.py` searches where the body presses, `search/hand_search.py` where the hand does; plans leg by leg
are `planner.py`'s. Joint searches do not cover props, inner doors, rewards of the puzzle, and arms that collide or
have many joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.kinematics import RoomState
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.routes import Routes
from hrl_escape.planning.search.joint_search import JointSearch

MOST_JOINTS = 4
"""Most joints of a pressing arm for joint searches: its tables then take a millisecond."""
MOST_FLOOR = 1_000.0
"""Largest floor for joint searches by hand, m^2: each posture's field then takes 0.1 s."""


class Escapes:
    """Joint searches of one room, made on first use; pickling drops them.

    Args:
        routes: routes of the room, whose grids and lock they share.
    """

    def __init__(self, routes: Routes) -> None:
        self._routes, self._instance = routes, routes.instance
        self._by_hand = routes.instance.dynamics.press_with == "hand"
        self._joint: JointSearch | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_joint": None}

    def can_join(self, order: Sequence[Goal]) -> bool:
        """Return whether legs to these goals can be planned jointly: only presses, and no rewards of the puzzle."""
        room = self._instance
        is_plain = not (room.props or room.inner_doors or room.puzzle.has_reward)
        if self._by_hand:  # arms that collide, or with many joints, take long
            is_plain &= room.dynamics.kind == "kinematic" and room.robot.joints <= MOST_JOINTS
            is_plain &= 4 * room.reach_x * room.reach_y <= MOST_FLOOR
        return is_plain and all(isinstance(goal, (PressGoal, ExitGoal)) for goal in order)

    def _get_search(self) -> JointSearch:
        """Joint search of the room, made on first use; the caller must hold the lock."""
        if self._joint is None and self._by_hand:
            from hrl_escape.planning.search.hand_search import HandSearch  # loads Pinocchio

            self._joint = HandSearch(self._routes.search)
        elif self._joint is None:
            self._joint = JointSearch(self._routes.search)
        return self._joint

    def shorten(self, state: RoomState, order: Sequence[Goal], most: int, clock: Clock, effort: int, budget: int
                ) -> tuple[tuple[int, ...] | None, tuple[Goal, ...], int]:
        """Search for an escape of fewer than `most` primitives.

        Args:
            state: first state; heading and joints are on their lattices.
            order: goals of a known escape, for which `can_join` holds.
            most: its primitives.
            clock: time limit.
            effort: 0, 1 or 2; higher values search longer.
            budget: search nodes.

        Returns:
            The primitives, or None; the goals that they reach; and the nodes expanded (0 once the clock is up).
        """
        with self._routes.lock:
            search = self._get_search()
            try:
                found, spent = search.find_escape(state, order, most, clock=clock, effort=effort, budget=budget)
            except OutOfTime:
                return None, (), 0
            return found, () if found is None else search.list_goals(state, found), spent

    def find_leg(self, state: RoomState, order: Sequence[Goal]) -> tuple[tuple[int, ...], tuple[Goal, ...]] | None:
        """Primitives and goal of the next leg, chosen so that the rest is short; None without a joint search."""
        if self._by_hand or not self.can_join(order):
            return None
        with self._routes.lock:
            search = self._get_search()
            found = search.find_leg(state, order)
            return None if found is None else (found, search.list_goals(state, found)[:1])
