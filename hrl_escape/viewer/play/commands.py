"""Commands of manual mode carried out on an episode, and the message that each leaves.

Browser and terminal share this; how a message or a state is shown is their own affair.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.errors import FileReadError
from hrl_escape.files import read_json, write_json
from hrl_escape.viewer.play.controls import Command
from hrl_escape.viewer.play.episode import Episode, PlayedMove
from hrl_escape.viewer.play.saved_episode import save_episode

PERSONAL_BESTS = "personal-bests.json"
"""File of the best returns of one's own by room, in the folder of saved episodes."""


def carry_out(command: Command, episode: Episode, folder: Path, best: float | None = None) -> str:
    """Do what a key asks for.

    Args:
        command: from `Controls`.
        episode: what is played.
        folder: where episodes are saved.
        best: best known return of the room, if it is known yet.

    Returns:
        A message for the player.

    Raises:
        UnsupportedError: there is no next room.
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
    if episode.end is EpisodeEnd.ESCAPED:
        said = praise(episode.total, best)
        return f"{said}{'' if said.endswith('!') else '.'} {_keep_personal_best(episode, folder)}"
    return episode.end.words.capitalize() if episode.is_over else _describe(move, episode)


def praise(total: float, best: float | None) -> str:
    """Words on an escape: its return, and how far it is from the best known one, where that is known."""
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
    """Write down an escape that is better than one's own before in this room, and say so."""
    path, room = folder / PERSONAL_BESTS, episode.instance.id + ("-hidden" if episode.discovery is not None else "")
    kept: dict[str, float] = {}
    with contextlib.suppress(FileReadError, TypeError, ValueError, AttributeError):  # none yet, or a damaged one
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
