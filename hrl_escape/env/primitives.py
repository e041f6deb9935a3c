"""The action table: the primitive of each action number (paper, table 3).

This is the only definition of the primitives. Engines, planners, options, drawings and the command line read it; all
other modules are independent of the number of primitives, their order, and how far moves go. Lengths are in metres,
turns in whole turn steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range, Settings

DriveKind = Literal["strafing", "differential"]
"""Drives of the base: moves along and across its heading, or along it only."""


class Primitive(NamedTuple):
    """One primitive action.

    Attributes:
        name: name, such as `strafe-left` or `joint-2-decrement`.
        forward: displacement along the heading, m.
        left: displacement to the left of the heading, m.
        turn: turn steps, counter-clockwise positive.
        joint: index of the joint that moves, or -1.
        joint_change: change of the joint, joint steps.
        grip: 1 to grip, -1 to release, 2 to use.
    """

    name: str
    forward: float = 0.0
    left: float = 0.0
    turn: int = 0
    joint: int = -1
    joint_change: int = 0
    grip: int = 0

    @property
    def length(self) -> float:
        """Length of the displacement, m."""
        return math.hypot(self.forward, self.left)

    def compute_move(self, cos: Any, sin: Any, scale: float = 1.0) -> tuple[Any, Any]:
        """Return the displacement along x and y at a heading, times `scale`, m. Accepts numbers and arrays."""
        forward, left = scale * self.forward, scale * self.left
        return forward * cos - left * sin, forward * sin + left * cos


@dataclass(frozen=True)
class Move(Settings):
    """An additional primitive of the base: one straight move, or one turn on the spot."""

    _section = "move"
    name: str = "leap"
    """Unique name among the robot's primitives."""
    forward: Annotated[float, Range(-20, 20, "m")] = 0.0
    """Displacement along the heading."""
    left: Annotated[float, Range(-20, 20, "m")] = 0.0
    """Displacement to the left of the heading."""
    turn: Annotated[int, Range(-180, 180, "turn steps")] = 0
    """Turn on the spot, counter-clockwise positive."""

    def check(self) -> None:
        """Check that the primitive either moves or turns."""
        if not self.name:
            raise ConfigError("move.name", self.name, "a name")
        if bool(self.turn) == bool(self.forward or self.left):
            raise ConfigError("move", (self.forward, self.left, self.turn), "either a displacement or a turn")


class JointActions(NamedTuple):
    """Action numbers of one joint."""

    increment: int
    decrement: int


@dataclass(frozen=True)
class ActionTable:
    """The primitives of a robot in action order: translations, turns, joints, gripper.

    The groups are ranges of action numbers. Primitives of the base come first and are the same for all robots with the
    same drive and the same moves.
    """

    primitives: tuple[Primitive, ...]  # all primitives; an action is an index
    names: tuple[str, ...]  # their names
    translations: range  # moves of the base at its heading: `forward`, the others of the drive, then additional ones
    turns: range  # turns of the base: one turn step to the left, one to the right, then additional ones
    base: range  # translations and turns
    joints: tuple[JointActions, ...]  # increment and decrement of each joint
    gripper: range  # grip, release, and use if the robot has it; empty without a gripper
    wait: int  # the no-op: it never moves the base's axis, and with a disc base it never begins a press
    symmetry: int  # number of evenly spaced headings with the same moves

    def __len__(self) -> int:
        return len(self.primitives)

    @property
    def stride(self) -> float:
        """Length of `forward`, m. Grids of planners depend on it, and grip and use reach that far ahead."""
        return self.primitives[0].forward

    @cached_property
    def lengths(self) -> NDArray[np.float64]:
        """Lengths of the translations, m, shape (translations,)."""
        return np.array([self.primitives[action].length for action in self.translations])

    @cached_property
    def longest(self) -> float:
        """Length of the longest translation, m: the largest displacement of any primitive."""
        return float(self.lengths.max())

    @cached_property
    def turn_steps(self) -> NDArray[np.int64]:
        """Turn steps of each turn, counter-clockwise positive, shape (turns,)."""
        return np.array([self.primitives[action].turn for action in self.turns])

    def compute_moves(self, cos: NDArray[np.float64], sin: NDArray[np.float64], scale: float = 1.0
                      ) -> NDArray[np.float64]:
        """Return the displacements of all translations at headings, times `scale`, m, (headings, translations, 2)."""
        moves = [np.stack(self.primitives[action].compute_move(cos, sin, scale), axis=-1)
                 for action in self.translations]
        return np.stack(moves, axis=1)

    def find(self, name: str) -> int:
        """Return the action number of a primitive.

        Raises:
            ValueError: no primitive of that name.
        """
        return self.names.index(name)


_DIRECTIONS = (("forward", 1.0, 0.0), ("back", -1.0, 0.0), ("strafe-left", 0.0, 1.0), ("strafe-right", 0.0, -1.0))
_TURNS = (Primitive("turn-left", turn=1), Primitive("turn-right", turn=-1))
_GRIPPER = (Primitive("grip", grip=1), Primitive("release", grip=-1))
_USE = (Primitive("use", grip=2),)
_WAIT = "turn-left"


@lru_cache
def make_action_table(joints: int, gripper: bool = False, drive: DriveKind = "strafing", use: bool = False,
                      move_step: float = 1.0, moves: tuple[Move, ...] = ()) -> ActionTable:
    """Make the action table of a robot with optional additional moves. Names number the joints from 1."""
    further = tuple(Primitive(move.name, move.forward, move.left, move.turn) for move in moves)
    translations = (*(Primitive(name, forward * move_step, left * move_step) for name, forward, left in _DIRECTIONS
                      if drive == "strafing" or not left), *(move for move in further if not move.turn))
    base = (*translations, *_TURNS, *(move for move in further if move.turn))
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
        symmetry=_count_symmetry(translations),
    )


def _count_symmetry(moves: tuple[Primitive, ...]) -> int:
    """Symmetry of translations under quarter and half turns: 4, 2 or 1."""
    ways = {(move.forward, move.left) for move in moves}
    if ways == {(-left, forward) for forward, left in ways}:
        return 4
    return 2 if ways == {(-forward, -left) for forward, left in ways} else 1


SlipKind = Literal["stay", "lateral", "lateral-if-free", "any", "neighbour"]


def list_slips(kind: SlipKind, actions: ActionTable, action: int) -> tuple[int, ...]:
    """Return the translations that a slip can turn an action into, all equally likely.

    `lateral`: translations at right angles to it; `any`: all others; `neighbour`: all, if they are free. Empty for
    primitives that do not translate.
    """
    if action not in actions.translations:
        return ()
    if kind == "neighbour":
        return tuple(actions.translations)
    others = tuple(n for n in actions.translations if n != action)
    if kind == "any":
        return others
    moves = actions.primitives
    way = moves[action]
    return tuple(n for n in others if moves[n].forward * way.forward + moves[n].left * way.left == 0.0)
