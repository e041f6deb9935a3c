"""What the rooms' planners, which run on the host, tell rooms of a batch: the primitives to follow next.

Presses by hand are planned throughout, by the planners and the closed loop of `OptionsEnv`'s meta-actions;
presses by body only where their fields lead nowhere. What rooms then do with a plan is `stepping.py`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_escape.env.tensor_room import TensorRoom
from hrl_escape.errors import PlanningFailed
from hrl_escape.options.batched.decisions import PLANNED, Running
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.synthesis import PlannedOption

__all__ = ["Guide"]


class Guide:
    """Asks the planners of a batch of rooms, and remembers for each room what its option is at.

    Args:
        room: the batch.
    """

    def __init__(self, room: TensorRoom) -> None:
        self._room = room
        self._planners: dict[int, RoomPlanner] = {}
        self._options: dict[int, PlannedOption] = {}
        self._rests: dict[int, tuple[int, ...]] = {}

    def plan(self, running: Running, where: Tensor, goals: Tensor) -> tuple[Running, Tensor]:
        """Give rooms a plan from where they are, or the beginning of it if it is longer than what they keep.

        Args:
            running: their decisions.
            where: the rooms to plan in, bool (rooms,).
            goals: target, or the number of targets for the exit, int64 (rooms,).

        Returns:
            The decisions with plans, and the rooms in which planning failed, bool (rooms,).
        """
        rooms = where.nonzero().squeeze(1).tolist()
        return self._follow(running, rooms, [self._find_plan(room, int(goals[room]))[:PLANNED] for room in rooms])

    def pursue(self, running: Running, where: Tensor, goals: Tensor) -> tuple[Running, Tensor]:
        """Give rooms what the plan made at their decision's start has next, for arguments and results see `plan`.

        Where noise or slip may lead off the plan it is one primitive, chosen by the closed loop of `PlannedOption`.
        """
        rooms = where.nonzero().squeeze(1).tolist()
        ask = self._choose if self._room.layout.is_random else self._go_on
        return self._follow(running, rooms, [ask(room, int(goals[room]), int(running.duration[room]) == 0)
                                             for room in rooms])

    def _get_planner(self, room: int) -> RoomPlanner:
        number = int(self._room.state.instance[room])
        if number not in self._planners:
            self._planners[number] = get_planner(self._room.instances[number])
        return self._planners[number]

    def _make_goal(self, number: int) -> Goal:
        return PressGoal(number) if number < self._room.layout.targets else ExitGoal()

    def _find_plan(self, room: int, goal: int) -> tuple[int, ...]:
        try:
            route = self._get_planner(room).find_route(self._room.get_room_state(room), self._make_goal(goal))
        except PlanningFailed:
            return ()
        return route.primitives

    def _go_on(self, room: int, goal: int, is_new: bool) -> tuple[int, ...]:
        plan = (not is_new and self._rests[room]) or self._find_plan(room, goal)
        self._rests[room] = plan[PLANNED:]
        return plan[:PLANNED]

    def _choose(self, room: int, goal: int, is_new: bool) -> tuple[int, ...]:
        state = self._room.get_room_state(room)
        try:
            if is_new:
                self._options[room] = PlannedOption("planned", self._get_planner(room), self._make_goal(goal))
                self._options[room].start(state)
            return (int(self._options[room].policy(state)),)
        except PlanningFailed:
            return ()

    def _follow(self, running: Running, rooms: list[int], plans: list[tuple[int, ...]]) -> tuple[Running, Tensor]:
        has_failed = torch.zeros_like(running.planned, dtype=torch.bool)
        if not rooms:
            return running, has_failed
        plan, planned = running.plan.clone(), running.planned.clone()
        table = torch.zeros((PLANNED, len(rooms)), dtype=plan.dtype)
        for column, found in enumerate(plans):
            if found:
                table[PLANNED - len(found) :, column] = torch.tensor(found, dtype=plan.dtype)
        where = torch.tensor(rooms, device=plan.device)
        lengths = torch.tensor([len(found) for found in plans], dtype=planned.dtype, device=planned.device)
        plan[:, where], planned[where], has_failed[where] = table.to(plan.device), lengths, lengths == 0
        return running._replace(plan=plan, planned=planned), has_failed
