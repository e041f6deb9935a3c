"""Keys and commands of manual mode: the meaning of each key, the effect of a command on an episode, and its message.

`Controls` stores the chosen joint and the meta-action that is being typed. It does not step the episode.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import NamedTuple

from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.primitives import ActionTable
from hrl_escape.errors import FileReadError
from hrl_escape.files import read_json, write_json
from hrl_escape.text.recordings import save_games
from hrl_escape.viewer.play.episode import Episode, PlayedMove, save_episode

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
    """The keyboard of one player. `options` meta-actions, the exit's last, follow the robot's primitives.

    Attributes:
        joint: index of the chosen joint.
        typed: digits of a meta-action so far, or None if none is being typed.
    """

    def __init__(self, actions: ActionTable, options: int) -> None:
        self._actions, self._joints, self._options = actions, len(actions.joints), options
        self.joint = 0
        self.typed: str | None = None

    @property
    def digits(self) -> int:
        """Number of digits of a meta-action's number."""
        return len(str(self._options - 1))

    def press(self, key: str) -> Command | None:
        """Process one key, a name in `KEYS`. Returns its command, or None if it has no effect yet."""
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
        """Continue typing a meta-action; any other key cancels it and keeps its own meaning."""
        typed, self.typed = self.typed or "", None
        if not key.isdigit():
            return self.press(key) if key != "m" else Command("note", note="cancelled")
        typed += key
        if len(typed) < self.digits:
            self.typed = typed
            return Command("note", note=f"meta-action {typed}\N{HORIZONTAL ELLIPSIS}")
        number = int(typed)
        if number >= self._options:
            return Command("note", note=f"there is no meta-action {number}: type 1 to {self._options - 1}, or 0 for "
                                        "the exit")
        return Command("act", len(self._actions) + (number - 1 if number else self._options - 1))


PERSONAL_BESTS = "personal-bests.json"
"""File of the player's best returns by room, in the folder of saved episodes."""


def carry_out(command: Command, episode: Episode, folder: Path, best: float | None = None) -> str:
    """Execute a command; return a message for the player.

    Episodes are saved in `folder`. `best` is the best known return of the room, or None while it is unknown.

    Raises:
        UnsupportedError: the room comes from a file and has no next room.
        FileWriteError: the episode, or the personal best, could not be saved.
    """
    if command.verb == "act":
        return _act(command.action, episode, folder, best)
    if command.verb == "undo":
        move = episode.undo()
        return "There is nothing to undo" if move is None else f"{move.name} taken back"
    if command.verb == "reset":
        episode.reset()
        return "Started again"
    if command.verb == "next":
        episode.enter_next_room()
        return "A new room"
    if command.verb == "save":
        saved = episode.to_saved()
        path = folder / saved.file_name
        save_episode(path, saved)
        return f"Saved as {path}"
    if command.verb == "quit":
        return "The game is over; close this page"
    return command.note


def _act(action: int, episode: Episode, folder: Path, best: float | None) -> str:
    if episode.is_over:
        return "This episode is over: R starts again, Z takes the last move back, N enters the next room"
    move = episode.do(action)
    if move is None:
        return f"{episode.names[action]} cannot start here"
    if not episode.is_over:
        return _describe(move, episode)
    recorded = _record_first_try(episode, folder)
    if episode.end is not EpisodeEnd.ESCAPED:
        return f"{episode.end.words.capitalize()}{recorded}"
    said = praise(episode.total, best)
    return f"{said}{'' if said.endswith('!') else '.'} {_keep_personal_best(episode, folder)}{recorded}"


def _record_first_try(episode: Episode, folder: Path) -> str:
    """Record a first try with a hidden graph as a game, see `hrl-escape talk --games`; return words for a message."""
    if episode.discovery is None or not episode.is_first_try:
        return ""
    path = (folder / f"game-{episode.to_saved().file_name}").with_suffix(".jsonl")
    save_games(path, [episode.to_game()])
    return f". The game is recorded as {path}"


def praise(total: float, best: float | None) -> str:
    """Return a message on an escape: its return, and the difference from the best known one, if that is known."""
    words = f"Escaped with a return of {total:g}"
    if best is None:
        return words
    ahead = total - best
    if abs(ahead) < 1e-9:
        return f"{words}: the best known!"
    if ahead > 0:
        return f"{words}: {ahead:g} better than the best known!"
    return f"{words}, {-ahead:g} short of the best known"


def _keep_personal_best(episode: Episode, folder: Path) -> str:
    """Record an escape that is better than the player's earlier ones in this room; return a message."""
    path, room = folder / PERSONAL_BESTS, episode.instance.id + ("-hidden" if episode.discovery is not None else "")
    kept: dict[str, float] = {}
    with contextlib.suppress(FileReadError, TypeError, ValueError, AttributeError):  # missing or damaged
        kept = {str(name): float(value) for name, value in read_json(path, "personal bests").items()}
    before = kept.get(room)
    if before is not None and before >= episode.total:
        return f"Your best is {before:g}"
    write_json(path, {**kept, room: episode.total})
    return "Your first escape from this room" if before is None else f"Your best so far; it was {before:g}"


def _describe(move: PlayedMove, episode: Episode) -> str:
    """Name of a move, its length, why it failed, and the targets that it pressed."""
    if move.ended == "planning-failed":
        return f"{move.name}: {move.reason}"
    words = f"{move.name} ({len(move.steps)} primitives)" if len(move.steps) > 1 else move.name
    pressed = [episode.instance.targets[i].name for step in move.steps for i in step.pressed]
    return words + (f", pressed {', '.join(pressed)}" if pressed else "")
