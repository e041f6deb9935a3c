"""The action table: which primitive each action number means (paper, table 3).

One definition that the environment, planners, drawings and the batched engine read.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["BASE_PRIMITIVES", "Primitive", "make_primitives"]


class Primitive(NamedTuple):
    """One primitive action.

    Attributes:
        name: such as `strafe-left` or `joint-2-decrement`.
        forward: displacement along the heading, in move steps.
        left: displacement to the left of the heading, in move steps.
        turn: turn steps, counter-clockwise positive.
        joint: index of the joint that moves, or -1.
        joint_change: joint steps.
    """

    name: str
    forward: int = 0
    left: int = 0
    turn: int = 0
    joint: int = -1
    joint_change: int = 0


BASE_PRIMITIVES = (
    Primitive("forward", forward=1),
    Primitive("back", forward=-1),
    Primitive("strafe-left", left=1),
    Primitive("strafe-right", left=-1),
    Primitive("turn-left", turn=1),
    Primitive("turn-right", turn=-1),
)


def make_primitives(joints: int) -> tuple[Primitive, ...]:
    """Return the `6 + 2 * joints` primitives in action order; joints are numbered from 1 in names."""
    arm = (
        Primitive(f"joint-{joint + 1}-{word}", joint=joint, joint_change=change)
        for joint in range(joints)
        for word, change in (("increment", 1), ("decrement", -1))
    )
    return BASE_PRIMITIVES + tuple(arm)
