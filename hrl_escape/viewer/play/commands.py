"""Commands of manual mode carried out on an episode, and the message that each leaves.

Browser and terminal share this; how a message or a state is shown is their own affair.
"""

from __future__ import annotations

from pathlib import Path

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.viewer.play.controls import Command
from hrl_escape.viewer.play.episode import Episode, PlayedMove
from hrl_escape.viewer.play.saved_episode import save_episode

__all__ = ["carry_out"]


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
        FileWriteError: the episode could not be saved.
    """
    if command.verb == "act":
        return _act(command.action, episode, best)
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


def _act(action: int, episode: Episode, best: float | None) -> str:
    if episode.is_over:
        return "This episode is over: R starts again, Z takes the last move back, N enters the next room"
    move = episode.do(action)
    if move is None:
        return f"{episode.names[action]} cannot start here"
    if episode.end is EpisodeEnd.ESCAPED:
        praise = " \N{EM DASH} the best known!" if best is not None and episode.total >= best - 1e-9 else ""
        return f"Escaped with a return of {episode.total:g}{praise}"
    return episode.end.words.capitalize() if episode.is_over else _describe(move, episode)


def _describe(move: PlayedMove, episode: Episode) -> str:
    """Name of a move, its length, why it failed, and the targets that it pressed."""
    if move.ended == "planning-failed":
        return f"{move.name}: {move.reason}"
    words = f"{move.name} ({len(move.steps)} primitives)" if len(move.steps) > 1 else move.name
    pressed = [episode.instance.targets[i].name for step in move.steps for i in step.pressed]
    return words + (f", pressed {', '.join(pressed)}" if pressed else "")
