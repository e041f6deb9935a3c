"""Keys of manual mode: one table of meanings that browser and terminal share.

`Controls` turns one key after another into commands. It remembers the chosen joint and a
meta-action that is being typed. It steps nothing.
"""

from __future__ import annotations

from typing import NamedTuple

from hrl_escape.env.primitives import ActionTable

MOVES = {
    "w": "forward", "s": "back", "a": "strafe-left", "d": "strafe-right",
    "up": "forward", "down": "back", "left": "turn-left", "right": "turn-right",
}
OTHERS = {"r": "reset", "n": "next", "z": "undo", "f": "save", "q": "quit"}
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
    ("F", "save"),
)


class Command(NamedTuple):
    """Meaning of a key."""

    verb: str  # `act`, `undo`, `reset`, `next`, `save`, `quit`; or `note`, a message only
    action: int = -1  # number of the primitive or option, for `act`
    note: str = ""  # the message


class Controls:
    """The keyboard of one player.

    Args:
        actions: the robot's primitives.
        options: number of meta-actions, the exit's included; they follow the primitives.

    Attributes:
        joint: index of the chosen joint.
        typed: digits of a meta-action so far; None if none is being typed.
    """

    def __init__(self, actions: ActionTable, options: int) -> None:
        self._actions, self._joints, self._options = actions, len(actions.joints), options
        self.joint = 0
        self.typed: str | None = None

    @property
    def digits(self) -> int:
        """Number of digits that name a meta-action."""
        return len(str(self._options - 1))

    def press(self, key: str) -> Command | None:
        """Take one key, as named in `KEYS`; None if it means nothing, or nothing yet."""
        if self.typed is not None:
            return self._type(key)
        if key == "m":
            self.typed = ""
            return Command("note", note="meta-action: type its " + ("number" if self.digits == 1 else
                                                                    f"{self.digits} digits") + ", 0 for the exit")
        if key in MOVES:
            if MOVES[key] not in self._actions.names:
                return Command("note", note="this base does not strafe")
            return Command("act", self._actions.find(MOVES[key]))
        if key in OTHERS:
            return Command(OTHERS[key])
        if key in ("u", "j"):
            if not self._joints:
                return Command("note", note="this robot has no arm")
            pair = self._actions.joints[self.joint]
            return Command("act", pair.increment if key == "u" else pair.decrement)
        if key.isdigit() and 1 <= int(key) <= self._joints:
            self.joint = int(key) - 1
            return Command("note", note=f"joint {key} chosen")
        return None

    def _type(self, key: str) -> Command | None:
        """Go on typing a meta-action; any other key cancels it and keeps its own meaning."""
        typed, self.typed = self.typed or "", None
        if not key.isdigit():
            return self.press(key) if key != "m" else Command("note", note="cancelled")
        typed += key
        if len(typed) < self.digits:
            self.typed = typed
            return Command("note", note=f"meta-{typed}\N{HORIZONTAL ELLIPSIS}")
        number = int(typed)
        if number >= self._options:
            return Command("note", note=f"there is no meta-{number:02d}; 1 to {self._options - 1}, or 0 for the exit")
        return Command("act", len(self._actions) + (number - 1 if number else self._options - 1))
