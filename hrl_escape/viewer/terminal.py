"""Manual mode without a browser: the room from above in letters, and keys from the terminal; works over ssh.

Where stdin is no terminal, its characters are taken as keys, so that a game can be piped in.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text

from hrl_escape.env import looks
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, Rules
from hrl_escape.errors import EscapeError
from hrl_escape.options.best_known import best_known_return
from hrl_escape.options.routes import get_prop_poses
from hrl_escape.viewer.controls import HELP, Command, Controls
from hrl_escape.viewer.episode import Episode, save_episode

__all__ = ["draw_room", "play_in_terminal", "read_keys"]

_ARROWS = "\N{RIGHTWARDS ARROW}\N{NORTH EAST ARROW}\N{UPWARDS ARROW}\N{NORTH WEST ARROW}" \
          "\N{LEFTWARDS ARROW}\N{SOUTH WEST ARROW}\N{DOWNWARDS ARROW}\N{SOUTH EAST ARROW}"
_SEQUENCES = {"[A": "up", "[B": "down", "[C": "right", "[D": "left", "OA": "up", "OB": "down", "OC": "right",
              "OD": "left"}
_WALL, _OBSTACLE, _TRAIL = ("\N{FULL BLOCK}", "#7b818c"), ("\N{MEDIUM SHADE}", looks.OBSTACLE_EDGE), ("\N{MIDDLE DOT}",
                                                                                                     looks.TRAIL)
MOST_ROWS = 36


def play_in_terminal(episode: Episode, folder: Path) -> None:
    """Play until `q` or the end of the keys."""
    console = Console(highlight=False)
    live = sys.stdin.isatty() and console.is_terminal
    controls = Controls(episode.instance.robot.joints, len(episode.option_names))
    note = "Press the buttons in the order of their graph, then drive into the exit"
    best = best_known_return(episode.instance)
    keys = read_keys(sys.stdin.fileno())
    with _raw(live):
        if live:
            _show(console, episode, note, best, live)
        for key in keys:
            command = Command("save") if key == "f" else controls.press(key)
            if command is None:
                continue
            if command.verb == "quit":
                break
            room = episode.instance.id
            try:
                note = _do(episode, command, folder)
            except EscapeError as error:
                note = str(error)
            if episode.instance.id != room:
                controls = Controls(episode.instance.robot.joints, len(episode.option_names))
                best = best_known_return(episode.instance)
            if live:
                _show(console, episode, note, best, live)
    if not live:
        _show(console, episode, note, best, live)


def _do(episode: Episode, command: Command, folder: Path) -> str:
    """Do what a key asks for, and say what came of it."""
    if command.verb == "undo":
        move = episode.undo()
        return "There is nothing to undo" if move is None else f"{move.name} taken back"
    if command.verb == "reset":
        episode.reset()
        return "Started again"
    if command.verb == "next":
        episode.go_on()
        return "A new room"
    if command.verb == "save":
        saved = episode.to_saved()
        path = folder / f"{saved.instance.name}-{saved.instance.seed}-{len(saved.primitives)}-primitives.json"
        save_episode(path, saved)
        return f"Saved as {path}"
    if command.verb == "note":
        return command.note
    if episode.is_over:
        return "This episode is over: r starts again, z takes the last move back, n enters the next room"
    move = episode.do(command.action)
    if move is None:
        return f"{episode.names[command.action]} cannot start here"
    pressed = [episode.instance.targets[i].name for step in move.steps for i in step.pressed]
    words = f"{move.name} ({len(move.steps)})" if len(move.steps) > 1 else move.name
    return f"{words}{': ' + move.reason if move.reason else ''}{', pressed ' + ', '.join(pressed) if pressed else ''}"


# --- drawing -------------------------------------------------------------------------------------


def draw_room(instance: RoomInstance, states: list[RoomState], rules: Rules, columns: int, rows: int) -> Text:
    """The room from above at the last of some states, the way there as dots; a character is half as wide as high.

    Args:
        instance: the room.
        states: the episode so far.
        rules: of the room.
        columns: most characters a line.
        rows: most lines.
    """
    state, puzzle = states[-1], instance.puzzle
    wide, high = instance.reach_x + 0.5, instance.reach_y + 0.5
    size = max(2 * wide / (columns / 2), 2 * high / rows)  # m a line
    columns, rows = max(1, round(4 * wide / size)), max(1, round(2 * high / size))
    cells: list[list[tuple[str, str]]] = [[(" ", "")] * columns for _ in range(rows)]

    def put(x: float, y: float, character: str, style: str) -> None:
        column, row = int((x + wide) / (2 * wide) * columns), int((high - y) / (2 * high) * rows)
        if 0 <= column < columns and 0 <= row < rows:
            cells[row][column] = character, style

    is_open = puzzle.is_solved(state.puzzle)
    reach = size / 4
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.5) / columns * 2 * wide - wide, high - (row + 0.5) / rows * 2 * high
            if instance.exit.contains(x, y):
                cells[row][column] = ("\N{LIGHT SHADE}", looks.EXIT_OPEN if is_open else looks.EXIT_LOCKED)
            for solid in instance.solids:
                if compute_distance(x, y, solid.footprint) <= reach:
                    cells[row][column] = _WALL if solid.role == "wall" else _OBSTACLE
            if instance.door is not None and not is_open and compute_distance(x, y, instance.door.footprint) <= reach:
                cells[row][column] = ("\N{DARK SHADE}", looks.DOOR)
    for past in states[:-1]:
        put(past.x, past.y, *_TRAIL)
    for placed, (x, y, _) in zip(instance.props, get_prop_poses(state, instance), strict=True):
        put(x, y, "\N{BLACK SQUARE}" if placed.prop.kind == "block" else "\N{WHITE SQUARE}", looks.PROP)
    for index, target in enumerate(instance.targets):
        look = looks.get_target_look(puzzle, state.puzzle, index)
        for n in range(-8, 9):
            put(target.x + n / 8 * target.half_x * math.cos(target.yaw),
                target.y + n / 8 * target.half_x * math.sin(target.yaw), " ", f"{look.ink} on {look.fill}")
        for n, character in enumerate(target.name.rpartition("-")[2]):
            put(target.x + n * size / 2, target.y, character, f"bold {look.ink} on {look.fill}")
    put(*instance.exit.centre, "E", f"bold {looks.EXIT_INK} on {looks.EXIT_OPEN if is_open else looks.EXIT_LOCKED}")
    arrow = _ARROWS[round(rules.get_heading(state) / (math.pi / 4)) % 8]
    put(state.x, state.y, arrow, f"bold white on {looks.BODY}")
    text = Text()
    for line in cells:
        for character, style in line:
            text.append(character, style)
        text.append("\n")
    return text


def _show(console: Console, episode: Episode, note: str, best: float, live: bool) -> None:
    size = shutil.get_terminal_size((80, 30))
    rows = min(size.lines - 6, MOST_ROWS)
    rules = Kinematics(episode.instance)
    picture = draw_room(episode.instance, episode.states, rules, size.columns - 1, rows)
    state = "escaped" if episode.escaped else "out of time" if episode.is_over else "inside"
    if live:
        console.clear()
    console.print(picture, end="", soft_wrap=True)
    console.print(f"[bold]{len(episode.steps)}[/bold] primitives, return [bold]{episode.total:g}[/bold], best known "
                  f"{best:g}: {state}", soft_wrap=True)
    console.print(Text(note), soft_wrap=True)
    if live:
        console.print(Text("  ".join(f"{keys}: {meaning}" for keys, meaning in HELP) + "  F: save  Q: quit", "dim"))


# --- keys ------------------------------------------------------------------------------------------


def read_keys(descriptor: int) -> Iterator[str]:
    """Keys by the names of `controls.KEYS`, one by one, until the input ends; arrows come as sequences."""
    while (letter := os.read(descriptor, 1)) != b"":
        if letter == b"\x1b":
            key = _SEQUENCES.get(os.read(descriptor, 2).decode("ascii", "replace"), "")
        elif letter == b"\x03":
            return
        else:
            key = letter.decode("ascii", "replace").lower()
        if key and not key.isspace():
            yield key


@contextmanager
def _raw(live: bool) -> Iterator[None]:
    """Let keys through one by one, unechoed; the terminal is set right again however this ends."""
    if not live:
        yield
        return
    import termios  # not on every system
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
