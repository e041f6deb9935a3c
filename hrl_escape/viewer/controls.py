"""Keys of manual mode: what each means, in one table that browser, window and terminal share.

`Controls` turns one key after another into commands; it remembers the chosen joint and a
meta-action that is being typed. It steps nothing.
"""

from __future__ import annotations

from typing import NamedTuple

from hrl_escape.env.primitives import BASE_PRIMITIVES

__all__ = ["HELP", "KEYS", "Command", "Controls"]

_NUMBERS = {primitive.name: number for number, primitive in enumerate(BASE_PRIMITIVES)}
MOVES = {
    "w": "forward", "s": "back", "a": "strafe-left", "d": "strafe-right",
    "up": "forward", "down": "back", "left": "turn-left", "right": "turn-right",
}
OTHERS = {"r": "reset", "n": "next", "z": "undo", "q": "quit"}
KEYS = (*MOVES, "u", "j", "m", *OTHERS, *"0123456789")
HELP = (
    ("W S \N{UPWARDS ARROW} \N{DOWNWARDS ARROW}", "ahead, back"),
    ("A D", "strafe"),
    ("\N{LEFTWARDS ARROW} \N{RIGHTWARDS ARROW}", "turn"),
    ("1\N{EN DASH}9", "choose a joint"),
    ("U J", "joint up, down"),
    ("M 1\N{EN DASH}9", "meta-action"),
    ("M 0", "to the exit"),
    ("Z", "undo"),
    ("R", "start again"),
    ("N", "next room"),
)


class Command(NamedTuple):
    """What a key asks for.

    Attributes:
        verb: `act`, `undo`, `reset`, `next`, `save`, `quit`; or `note`, something to tell only.
        action: number of the primitive or option, for `act`.
        note: what to tell.
    """

    verb: str
    action: int = -1
    note: str = ""


class Controls:
    """The keyboard of one player.

    Args:
        joints: of the robot's arm.
        options: number of meta-actions, the exit's included; they come after the primitives.

    Attributes:
        joint: index of the chosen joint.
        typed: digits of a meta-action so far; None if none is being typed.
    """

    def __init__(self, joints: int, options: int) -> None:
        self._joints, self._options = joints, options
        self._primitives = len(BASE_PRIMITIVES) + 2 * joints
        self.joint = 0
        self.typed: str | None = None

    @property
    def digits(self) -> int:
        """How many digits name a meta-action."""
        return len(str(self._options - 1))

    def press(self, key: str) -> Command | None:
        """Take in one key, as named in `KEYS`; None if nothing comes of it (yet)."""
        if self.typed is not None:
            return self._type(key)
        if key == "m":
            self.typed = ""
            return Command("note", note="meta-action: type its " + ("number" if self.digits == 1 else
                                                                    f"{self.digits} digits") + ", 0 for the exit")
        if key in MOVES:
            return Command("act", _NUMBERS[MOVES[key]])
        if key in OTHERS:
            return Command(OTHERS[key])
        if key in ("u", "j"):
            if not self._joints:
                return Command("note", note="this robot has no arm")
            return Command("act", len(BASE_PRIMITIVES) + 2 * self.joint + (key == "j"))
        if key.isdigit() and 1 <= int(key) <= self._joints:
            self.joint = int(key) - 1
            return Command("note", note=f"joint {key} chosen")
        return None

    def _type(self, key: str) -> Command | None:
        """Go on typing a meta-action; any other key gives it up and counts itself."""
        typed, self.typed = self.typed or "", None
        if not key.isdigit():
            return self.press(key) if key != "m" else Command("note", note="given up")
        typed += key
        if len(typed) < self.digits:
            self.typed = typed
            return Command("note", note=f"meta-{typed}\N{HORIZONTAL ELLIPSIS}")
        number = int(typed)
        if number >= self._options:
            return Command("note", note=f"there is no meta-{number:02d}; 1 to {self._options - 1}, or 0 for the exit")
        return Command("act", self._primitives + (number - 1 if number else self._options - 1))
