"""Plans for rooms of a batch, made by the rooms' planners on the host.

Orders of presses, for options that press ancestors first; and primitives, where the fields make no progress.
`stepping.py` runs the plans.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.errors import PlanningFailed
from hrl_escape.options.batched.decisions import NOT_ASKED, ORDER_LENGTH, PLAN_LENGTH, OpenDecisions
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.planner import RoomPlanner, get_planner

__all__ = ["HostPlanner"]


class HostPlanner:
    """Planners of a batch of rooms.

    Args:
        room: the batch.
    """

    def __init__(self, room: TensorRoom) -> None:
        self._room = room
        self._planners: dict[int, RoomPlanner] = {}

    def order(self, running: OpenDecisions, where: Tensor, targets: Tensor) -> OpenDecisions:
        """List the ancestors of presses and the presses themselves, in the order of options with ancestors.

        Args:
            running: the decisions.
            where: rooms that need an order, bool (rooms,).
            targets: the targets to press in the end, int64 (rooms,).

        Returns:
            The decisions with their next goals; still `NOT_ASKED` where the preconditions cannot be met.
        """
        rooms = where.nonzero().squeeze(1).tolist()
        if not rooms:
            return running
        order = torch.full((len(rooms), ORDER_LENGTH), NOT_ASKED, dtype=running.order.dtype)
        first, left = [NOT_ASKED] * len(rooms), [0] * len(rooms)
        for row, room in enumerate(rooms):
            found = self._find_order(room, int(targets[room]))
            if len(found) > ORDER_LENGTH:
                found = [*found[:ORDER_LENGTH], NOT_ASKED]
            if found:
                first[row], left[row] = found[0], len(found) - 1
                order[row, ORDER_LENGTH - left[row] :] = torch.tensor(found[1:], dtype=order.dtype)
        at, device = torch.tensor(rooms, device=where.device), where.device
        orders, goal, order_left = running.order.clone(), running.goal.clone(), running.order_left.clone()
        orders[:, at], goal[at] = order.T.contiguous().to(device), torch.tensor(first, device=device)
        order_left[at] = torch.tensor(left, dtype=order_left.dtype, device=device)
        return running._replace(order=orders, goal=goal, order_left=order_left)

    def plan(self, running: OpenDecisions, where: Tensor) -> tuple[OpenDecisions, Tensor]:
        """Plan from the present state of some rooms to their goals; each keeps the beginning of its plan.

        Args:
            running: their decisions.
            where: the rooms to plan in, bool (rooms,).

        Returns:
            The decisions with plans, and the rooms in which planning failed, bool (rooms,).
        """
        rooms = where.nonzero().squeeze(1).tolist()
        kept = 1 if self._room.layout.is_random else PLAN_LENGTH  # a slip invalidates what follows
        return self._store_plans(running, rooms, [self._find_plan(room, int(running.goal[room]))[:kept]
                                                  for room in rooms])

    def _get_planner(self, room: int) -> RoomPlanner:
        number = int(self._room.state.instance[room])
        if number not in self._planners:
            self._planners[number] = get_planner(self._room.instances[number])
        return self._planners[number]

    def _make_goal(self, number: int) -> Goal:
        return PressGoal(number) if number < self._room.layout.targets else ExitGoal()

    def _find_order(self, room: int, target: int) -> list[int]:
        try:
            goals = self._get_planner(room).orders.find_ancestors(self._room.get_room_state(room), PressGoal(target))
        except PlanningFailed:
            return []
        return [goal.target for goal in goals if isinstance(goal, PressGoal)]

    def _find_plan(self, room: int, goal: int) -> tuple[int, ...]:
        try:
            route = self._get_planner(room).routes.find_route(self._room.get_room_state(room), self._make_goal(goal))
        except PlanningFailed:
            return ()
        return route.primitives

    def _store_plans(self, running: OpenDecisions, rooms: list[int], plans: list[tuple[int, ...]]
                     ) -> tuple[OpenDecisions, Tensor]:
        has_failed = torch.zeros_like(running.plan_left, dtype=torch.bool)
        if not rooms:
            return running, has_failed
        plan, planned = running.plan.clone(), running.plan_left.clone()
        table = torch.zeros((PLAN_LENGTH, len(rooms)), dtype=plan.dtype)
        for column, found in enumerate(plans):
            if found:
                table[PLAN_LENGTH - len(found) :, column] = torch.tensor(found, dtype=plan.dtype)
        where = torch.tensor(rooms, device=plan.device)
        lengths = torch.tensor([len(found) for found in plans], dtype=planned.dtype, device=planned.device)
        plan[:, where], planned[where], has_failed[where] = table.to(plan.device), lengths, lengths == 0
        return running._replace(plan=plan, plan_left=planned), has_failed
