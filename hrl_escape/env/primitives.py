"""The action table: the primitive that each action number stands for (paper, table 3).

The one definition that engines, planners, options, drawings and the command line read. Nothing else knows how many
primitives there are, in which order they stand or which of them are moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["TURNS", "ActionTable", "DriveKind", "FootprintKind", "JointActions", "Primitive", "SlipKind", "list_slips",
           "make_action_table"]


DriveKind = Literal["strafing", "differential"]
"""Drives of the base: one that moves along and across its heading, or one that moves along it only."""

FootprintKind = Literal["disc", "rectangle"]
"""Outlines of the base on the floor: a disc, which turns anywhere, or a rectangle, whose turns may be blocked."""


class Primitive(NamedTuple):
    """One primitive action.

    Attributes:
        name: such as `strafe-left` or `joint-2-decrement`.
        forward: displacement along the heading, in move steps.
        left: displacement to the left of the heading, in move steps.
        turn: turn steps, counter-clockwise positive.
        joint: index of the joint that moves, or -1.
        joint_change: joint steps.
        grip: 1 to grip, -1 to release, 2 to use.
    """

    name: str
    forward: int = 0
    left: int = 0
    turn: int = 0
    joint: int = -1
    joint_change: int = 0
    grip: int = 0

    def compute_move(self, cos: Any, sin: Any) -> tuple[Any, Any]:
        """Displacement along x and y at a heading, in move steps; takes numbers and arrays alike."""
        return self.forward * cos - self.left * sin, self.forward * sin + self.left * cos


class JointActions(NamedTuple):
    """Action numbers of one joint."""

    increment: int
    decrement: int


@dataclass(frozen=True)
class ActionTable:
    """The primitives of a robot in action order: translations, turns, the joints, then the gripper.

    The groups hold action numbers. Those of the base come first and are the same for every robot with its drive.

    Attributes:
        primitives: all primitives; an action is an index.
        names: their names.
        translations: moves of the base along or across its heading.
        turns: turns of the base.
        base: translations and turns.
        joints: the pair of each joint.
        gripper: grip, release, and use if there is that; empty without a gripper.
        wait: the primitive to pass time with: it never moves the body's axis, and a disc presses nothing by it that it
            is not touching.
        symmetry: number of headings, evenly spread over a full turn, at which the base has the same moves.
    """

    primitives: tuple[Primitive, ...]
    names: tuple[str, ...]
    translations: range
    turns: range
    base: range
    joints: tuple[JointActions, ...]
    gripper: range
    wait: int
    symmetry: int

    def __len__(self) -> int:
        return len(self.primitives)

    def compute_moves(self, cos: NDArray[np.float64], sin: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements of all translations at headings, in move steps, shape (headings, translations, 2)."""
        moves = [np.stack(self.primitives[action].compute_move(cos, sin), axis=-1) for action in self.translations]
        return np.stack(moves, axis=1)

    def find(self, name: str) -> int:
        """Return the action number of a primitive.

        Raises:
            ValueError: no primitive of that name.
        """
        return self.names.index(name)


_TRANSLATIONS = (
    Primitive("forward", forward=1),
    Primitive("back", forward=-1),
    Primitive("strafe-left", left=1),
    Primitive("strafe-right", left=-1),
)
TURNS = (Primitive("turn-left", turn=1), Primitive("turn-right", turn=-1))
"""Turns of every base."""
_GRIPPER = (Primitive("grip", grip=1), Primitive("release", grip=-1))
_USE = (Primitive("use", grip=2),)
_WAIT = "turn-left"


@lru_cache
def make_action_table(joints: int, gripper: bool = False, drive: DriveKind = "strafing", use: bool = False
                      ) -> ActionTable:
    """Make the action table of a robot; names number its joints from 1."""
    translations = tuple(move for move in _TRANSLATIONS if drive == "strafing" or not move.left)
    base = translations + TURNS
    arm = tuple(
        Primitive(f"joint-{joint + 1}-{word}", joint=joint, joint_change=change)
        for joint in range(joints)
        for word, change in (("increment", 1), ("decrement", -1))
    )
    hand = (_GRIPPER if gripper else ()) + (_USE if use else ())
    primitives = base + arm + hand
    names = tuple(primitive.name for primitive in primitives)
    pairs = [(names.index(f"joint-{joint + 1}-increment"), names.index(f"joint-{joint + 1}-decrement"))
             for joint in range(joints)]
    return ActionTable(
        primitives=primitives,
        names=names,
        translations=range(len(translations)),
        turns=range(len(translations), len(base)),
        base=range(len(base)),
        joints=tuple(JointActions(*pair) for pair in pairs),
        gripper=range(len(base + arm), len(primitives)),
        wait=names.index(_WAIT),
        symmetry=len(translations),
    )


SlipKind = Literal["stay", "lateral", "lateral-if-free", "any", "neighbour"]


def list_slips(kind: SlipKind, actions: ActionTable, action: int) -> tuple[int, ...]:
    """Translations that one may slip to, all alike; those of `neighbour` are tried for being free.

    `lateral`: those at right angles to it; `any`: all others; `neighbour`: all; none of another primitive.
    """
    if action not in actions.translations:
        return ()
    if kind == "neighbour":
        return tuple(actions.translations)
    others = tuple(n for n in actions.translations if n != action)
    if kind == "any":
        return others
    moves = actions.primitives
    return tuple(n for n in others if bool(moves[n].forward) != bool(moves[action].forward))
