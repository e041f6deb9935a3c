"""Postures for presses by hand in a batch: a few dozen for each target, each with the field that leads to it.

Arms of kinematic rooms pass through everything, so the cost-to-go of a press is the least, over postures, of the joint
steps to a posture and the way of the base to where the hand then touches. Postures whose hands are close share a
field, and the base's place is shifted by the offset between their hands.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.planning.arm.reacher import Reacher

POSTURES = 64
"""Postures kept for a target."""
FAR = 20_000
"""Joint steps of postures that only pad a table, more than the length of any way."""
_MOST, _LEAST = 8, 2  # fields of one target
_NEAR = 0.15  # hands that are this close share a field, m


class PostureLibrary(NamedTuple):
    """Postures that press the targets of one instance."""

    steps: NDArray[np.int32]  # joint steps from home, int32 (targets, postures, joints)
    hands: NDArray[np.float64]  # hand in the base frame, m, float64 (targets, postures, 3)
    fields: NDArray[np.int64]  # number of the field of each, int64 (targets, postures)
    approaches: NDArray[np.float64]  # target of each field, and the hand for which it is, m: rows of (target, x, y, z)
    limit: float  # largest distance of the hand's centre from a target that touches, m


def choose_postures(instance: RoomInstance, fields: int) -> PostureLibrary:
    """Choose the postures of all targets: most of them the cheapest from home, the others far apart.

    Args:
        instance: the room.
        fields: approximate limit of all fields together; every target has two to eight.
    """
    count, reacher = len(instance.targets), Reacher(instance)
    steps = np.full((count, POSTURES, instance.robot.joints), FAR, dtype=np.int32)
    hands = np.zeros((count, POSTURES, 3))
    numbers = np.zeros((count, POSTURES), dtype=np.int64)
    approaches: list[tuple[float, ...]] = []
    most = min(max(fields // max(count, 1), _LEAST), _MOST)
    for target in range(count):
        every, places = reacher.list_postures(target)
        if len(every) == 0:
            continue
        chosen = _spread(every, list(range(min(len(every), POSTURES * 7 // 8))), POSTURES, 0.0)
        every, places = every[chosen], places[chosen]
        shown = _spread(places[:, :2], [0], most, _NEAR)
        away = np.linalg.norm(places[:, None, :2] - places[shown, :2], axis=2)
        steps[target, : len(every)], hands[target, : len(every)] = every, places
        numbers[target, : len(every)] = len(approaches) + away.argmin(axis=1)
        approaches += [(target, *places[n].tolist()) for n in shown]
    return PostureLibrary(steps, hands, numbers, np.array(approaches).reshape(-1, 4), reacher.limit)


def _spread(points: NDArray[Any], chosen: list[int], most: int, near: float) -> list[int]:
    """Add the farthest point to those chosen, again and again, up to `most` or until none is farther than `near`."""
    away = np.abs(points[:, None] - points[chosen]).sum(axis=2).min(axis=1)
    while len(chosen) < most and away.max() > near:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.abs(points - points[chosen[-1]]).sum(axis=1))
    return chosen
