"""Exploration and exploitation errors from actions alone, as Park et al. (arXiv 2604.13151) define them.

The estimate knows no distribution of graphs. Per decision, U is what has not been observed, P the known tasks that are
left, and g the goal. A decision should reach the targets T, which depend on the case:

| case | condition | targets T | counts for |
|---|---|---|---|
| 1 | P empty, U not | U | exploration |
| 2 | g in P | g | exploitation |
| 3 | P without g, U empty | P | exploitation |
| 4 | P without g, U not empty | U and P | both |

A decision that makes progress is not an error. One that leads to no target is an error. One that leads towards one of
several targets without progress is an error if it makes the trail since the last progress staler: S = c + e + n, with
c = edges - nodes + 1 of the trail, an undirected graph, and e and n the visits of edges and nodes beyond the second.
Each error is divided by the decisions that count for it.

In a room, U holds the presses whose result with the current lights is unknown: buttons that are off and were not tried
since a light changed. P holds the buttons that are off and are known to turn on with the current lights, and the exit
once it is open. A decision leads to a target if it presses it, or presses nothing and ends nearer to it. The nodes of
the trail are the buttons that were pressed. A decision that presses a button is progress or leads to no target, so the
staleness decides only about decisions that stay at a node, where c and e are constant: n alone is computed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.options.domain import DomainStep

EXIT, START = -1, -2
"""The exit among the targets, which are numbered from 0; and the start among the nodes of a trail."""


class ActionErrors(NamedTuple):
    """Shares of decisions that are errors.

    Attributes:
        exploration: errors divided by decisions in cases 1 and 4; 0 without such decisions.
        exploitation: errors divided by decisions in cases 2, 3 and 4; 0 without such decisions.
    """

    exploration: float
    exploitation: float


def estimate_errors(room: RoomInstance, decisions: Sequence[Sequence[DomainStep]]) -> ActionErrors:
    """Estimate the errors of an episode from its actions.

    Args:
        room: the room; its graph is not read.
        decisions: primitives of each decision, in order: `OptionsEnv.last_steps` or `TextEnv.decisions`.
    """
    knowledge, node = _Knowledge(room), START
    visits = Counter([node])  # of the trail's nodes
    errors, counts = Counter[str](), Counter[str]()
    for steps in decisions:
        unknown, pending = knowledge.list_targets(steps[0].state)
        wanted = {EXIT} if EXIT in pending else unknown | pending
        kinds = [kind for kind, counted in (("exploration", EXIT not in pending and unknown), ("exploitation", pending))
                 if counted]
        reached = knowledge.note(steps)
        if reached & wanted:
            is_error = False
            node, visits = max(reached), Counter([max(reached)])
        else:
            node = max(reached, default=node)
            visits[node] += 1
            leads = not reached and _leads_nearer(room, steps, wanted)
            is_error = not leads or (len(wanted) > 1 and visits[node] > 2)
        counts.update(kinds)
        errors.update(kinds if is_error else ())
    return ActionErrors(*(errors[kind] / max(counts[kind], 1) for kind in ("exploration", "exploitation")))


class _Knowledge:
    """Results of the presses so far."""

    def __init__(self, room: RoomInstance) -> None:
        self._room, self._puzzle = room, room.puzzle
        self._tried = set[int]()  # without effect since a light last changed
        self._known: dict[int, list[frozenset[int]]] = {}  # lights with which each button turned on

    def _get_lit(self, state: RoomState) -> frozenset[int]:
        return frozenset(i for i, on in enumerate(self._puzzle.get_lit(state.puzzle)) if on)

    def list_targets(self, state: RoomState) -> tuple[set[int], set[int]]:
        """Return U and P in a state."""
        lit = self._get_lit(state)
        dark = set(range(len(self._room.targets))) - lit
        pending = {target for target in dark if any(lights <= lit for lights in self._known.get(target, ()))}
        if self._puzzle.is_solved(state.puzzle):
            return dark - self._tried - pending, pending | {EXIT}
        return dark - self._tried - pending, pending

    def note(self, steps: Sequence[DomainStep]) -> set[int]:
        """Record a decision; return the targets that it pressed, and the exit if it left."""
        reached = set[int]()
        for step in steps:
            before, after = self._get_lit(step.state), self._get_lit(step.next_state)
            for target in list_touched(step.events.pressed):
                reached.add(target)
                if target in after - before:
                    self._known.setdefault(target, []).append(before)
                elif before == after:
                    self._tried.add(target)
            if before != after:
                self._tried.clear()
            if step.info["is_success"]:
                reached.add(EXIT)
        return reached


def _leads_nearer(room: RoomInstance, steps: Sequence[DomainStep], wanted: set[int]) -> bool:
    """Return whether a decision ends nearer to a target, by straight-line distance."""
    places = {EXIT: room.exit.centre} | {i: (target.x, target.y) for i, target in enumerate(room.targets)}
    first, last = steps[0].state, steps[-1].next_state
    return any(math.dist(places[target], (last.x, last.y)) < math.dist(places[target], (first.x, first.y)) - 1e-9
               for target in wanted)
