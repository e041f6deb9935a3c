"""Contacts: everything that the rules of a puzzle learn about a primitive."""

from __future__ import annotations

from typing import NamedTuple

USE = 2
"""`Contacts.grip` of the primitive `use`."""
PUSH = 3
"""`Contacts.grip` of a move that pushes."""


class Contacts(NamedTuple):
    """Contacts of one primitive with the puzzle's targets and props.

    Attributes:
        pressed: indices of targets whose touching began at this primitive's end, ascending.
        prop_poses: (x, y, yaw) of each prop in the room frame, metres and radians; they
            move under physics dynamics only. A puzzle with props gets these poses
            once before the first primitive, with nothing pressed.
        uniform: number between 0 and 1 drawn for this primitive, if the puzzle is random. 0, which is never drawn,
            stands for the most likely outcome: planners press with it, so an outcome of probability p should be that
            of numbers below p.
        touching: indices of all targets touched at its end, ascending: panels in reach, and pads stood on.
        grip: 1 if the primitive was `grip`, -1 if it was `release`, `USE` if it was `use`, `PUSH` if a move pushes the
            thing ahead of it, else 0. In a step of velocities it comes after the motion and what that pressed.
        has_moved: the body's axis has moved.
        x: place of the body's axis in the room frame, m.
        y: place of the body's axis in the room frame, m.
        ahead: number of the inner door (a cell that can be blocked) one move ahead of a primitive that grips, releases,
            uses or pushes; -1 where there is none.
        beyond: number of the inner door one more move ahead, into which a thing is pushed; -1 where there is none.
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
