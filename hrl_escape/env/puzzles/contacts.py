"""Contacts: the input of a puzzle's rules for one primitive."""

from __future__ import annotations

from typing import NamedTuple

USE = 2
"""`Contacts.grip` of the primitive `use`."""
PUSH = 3
"""`Contacts.grip` of a move that pushes."""


class Contacts(NamedTuple):
    """Contacts of one primitive with the puzzle's targets and props.

    Attributes:
        pressed: indices of targets whose contact began at the end of this primitive, ascending.
        prop_poses: (x, y, yaw) of each prop in the room frame, metres and radians. Props move under physics dynamics
            only. A puzzle with props receives these poses once before the first primitive, with nothing pressed.
        uniform: random number in (0, 1) for this primitive, if the puzzle is random. Planners pass 0 for the most
            likely outcome, and an outcome of probability p should therefore follow numbers below p.
        touching: indices of all targets in contact at the end, ascending: panels in reach, and pads under the axis.
        grip: 1 if the primitive was `grip`, -1 if it was `release`, `USE` if it was `use`, `PUSH` if a move pushes the
            thing ahead, otherwise 0. In environments with velocities it follows the motion and its presses.
        has_moved: whether the body's axis has moved.
        x: x of the body's axis in the room frame, m.
        y: y of the body's axis in the room frame, m.
        ahead: index of the inner door (a cell that can be blocked) one move ahead of a primitive that grips, releases,
            uses or pushes; -1 if there is none.
        beyond: index of the inner door two moves ahead, into which a thing is pushed; -1 if there is none.
    """

    pressed: tuple[int, ...]
    prop_poses: tuple[tuple[float, float, float], ...] = ()
    uniform: float = 0.0
    touching: tuple[int, ...] = ()
    grip: int = 0
    has_moved: bool = False
    x: float = 0.0
    y: float = 0.0
    ahead: int = -1
    beyond: int = -1
