"""Runs of options by the states in which they began: where nothing is random, they take the same primitives again.

Rooms that begin an option in a known state follow its primitives, and none has to be chosen. In a fixed room few states
begin options, as most are the ends of other options. Of rooms that begin the same new run in the same step, one chooses
for all.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.tables import Layout
from hrl_escape.options.batched.stepping import (
    PLAN_LENGTH,
    REACHED,
    OpenDecisions,
    StepSettings,
    Transitions,
    forget_progress,
)
from hrl_escape.options.batched.successors import presses_by_hand

MOST_KNOWN_RUNS = 100_000
"""Largest number of runs that a batch keeps, some 40 MB."""
_DECIDING = ("x", "y", "heading_steps", "heading_offset", "joint_steps", "joint_offsets", "puzzle", "touching",
             "instance")  # fields of a state that decide what an option does


def repeats_runs(layout: Layout, settings: StepSettings) -> bool:
    """Return whether known runs save time: presses by hand, of one room, where nothing is random.

    Presses by the body are chosen as fast. Several rooms, or primitives as actions, lead to many more states.
    """
    degradation = settings.degradation
    return layout.is_shared and presses_by_hand(layout) and not (
        settings.primitives or settings.interruptible or settings.has_ancestors or layout.dynamics.is_random
        or layout.is_puzzle_random or degradation.failure or degradation.early_stop or degradation.detour)


class KnownRuns:
    """Primitives of the runs that reached their goals, and which rooms of a batch follow or record one."""

    def __init__(self, count: int) -> None:
        """Begin without runs, for `count` rooms."""
        self._numbers: dict[bytes, int] = {}  # of the runs, by the states and actions that they began with
        self._primitives, self._lengths = torch.zeros((0, PLAN_LENGTH), dtype=torch.int8), list[int]()
        self._number = torch.full((count,), -1)  # of the run that each room follows
        self._own = torch.arange(count)
        self.leader = self._own
        """Rooms that choose for each room, mostly itself, int64 (rooms,)."""
        self._recorded: dict[bytes, int] = {}  # rooms that record a run, one for each
        self._taken = torch.zeros((count, PLAN_LENGTH), dtype=torch.int8)
        self._state: list[Tensor] = []  # after the last step

    @property
    def is_followed(self) -> Tensor:
        """Return which rooms follow a known run, bool (rooms,)."""
        return self._number >= 0

    def begin(self, state: TensorState, running: OpenDecisions, begins: Tensor, action: Tensor) -> OpenDecisions:
        """Find the runs of the options, int64 (rooms,), that begin in the rooms of `begins`, bool (rooms,).

        States that something else than a step has changed end all runs that are followed or recorded.
        """
        deciding = [getattr(state, name) for name in _DECIDING]
        if any(one is not other for one, other in zip(deciding, self._state, strict=True)):
            running = forget_progress(running, self.is_followed)
            self.drop(torch.ones_like(begins), state)
        at = begins.nonzero().squeeze(1)
        if not len(at):
            return running
        rows = [field[..., at].view(-1, len(at)) for field in (*deciding, action)]
        words = torch.cat([row.view(torch.int64) if row.is_floating_point() else row.to(torch.int64) for row in rows])
        table = words.T.contiguous().numpy()
        keys: list[bytes] = table.view(f"V{table.shape[1] * table.itemsize}")[:, 0].tolist()
        found = [self._numbers.get(key, -1) for key in keys]
        self._number[at] = torch.tensor(found)
        if min(found) >= 0:
            self.leader = self.leader.index_copy(0, at, at)
            return running
        rooms = at.tolist()
        new = {key: room for key, room, number in zip(keys, rooms, found, strict=True) if number < 0}
        leaders = [new.get(key, room) for key, room in zip(keys, rooms, strict=True)]
        self.leader = self.leader.index_copy(0, at, torch.tensor(leaders))
        if len(self._lengths) < MOST_KNOWN_RUNS:
            self._recorded = new | self._recorded  # a room that records already goes on
        return running

    def find_leading(self) -> Tensor:
        """Return which rooms choose for themselves or others, as they follow no known run, bool (rooms,)."""
        return (self._number < 0) & (self.leader == self._own)

    def read(self, begins: Tensor, running: OpenDecisions) -> Tensor:
        """Return the next primitives of the runs that are followed, int64 (rooms,); arbitrary elsewhere."""
        if not self._lengths:
            return torch.zeros_like(self._number)
        at = running.duration.masked_fill(begins, 0).clamp(max=PLAN_LENGTH - 1)
        return self._primitives[self._number.clamp(min=0), at].to(torch.int64)

    def write_plans(self, running: OpenDecisions) -> OpenDecisions:
        """Return decisions in which what is left of the runs that are followed are plans."""
        plan, left = running.plan.clone(), running.plan_left.clone()
        for room in (self.is_followed & (running.action >= 0)).nonzero().squeeze(1).tolist():
            number, done = int(self._number[room]), int(running.duration[room])
            rest = self._primitives[number, done : self._lengths[number]]
            plan[PLAN_LENGTH - len(rest) :, room], left[room] = rest, len(rest)
        return running._replace(plan=plan, plan_left=left)

    def record(self, state: TensorState, primitive: Tensor, done: Transitions) -> None:
        """Record the last primitives, int64 (rooms,), and keep the runs that reached their goals with them.

        `state` is the state after the step.
        """
        self._state = [getattr(state, name) for name in _DECIDING]
        self._number = self._number.masked_fill(done.where, -1)
        self.leader = torch.where(done.where[self.leader], self._own, self.leader)
        if not self._recorded:
            return
        at = torch.tensor(list(self._recorded.values()))
        duration, is_over = done.duration[at], done.where[at]
        self._taken[at, (duration - 1).clamp(max=PLAN_LENGTH - 1)] = primitive[at].to(torch.int8)
        if not is_over.any():
            return
        is_kept = is_over & (done.ended[at] == REACHED) & (duration <= PLAN_LENGTH)
        lists = (each.tolist() for each in (at, duration, is_over, is_kept))
        for key, room, length, ends, keeps in zip(list(self._recorded), *lists, strict=True):
            if keeps:
                self._keep(key, self._taken[room], length)
            if ends:
                del self._recorded[key]

    def _keep(self, key: bytes, primitives: Tensor, length: int) -> None:
        number = self._numbers[key] = len(self._lengths)
        if number == len(self._primitives):
            self._primitives = torch.cat([self._primitives, primitives.new_zeros(number + 64, PLAN_LENGTH)])
        self._primitives[number] = primitives
        self._lengths.append(length)

    def drop(self, where: Tensor, state: TensorState) -> None:
        """Follow and record no more in some rooms, bool (rooms,), whose state is now another."""
        self.leader = torch.where(where | where[self.leader], self._own, self.leader)
        self._number, dropped = self._number.masked_fill(where, -1), where.tolist()
        self._recorded = {key: room for key, room in self._recorded.items() if not dropped[room]}
        self._state = [getattr(state, name) for name in _DECIDING]
