"""Manual mode at a prompt: the player calls the tools that a language model would, in words; works over ssh.

If stdin is not a terminal, its lines are taken as commands, so that a game can be piped in.
"""

from __future__ import annotations

import math
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, Rules
from hrl_escape.env.puzzles.traits import Barring, get_trait
from hrl_escape.names import count_nouns, make_console_text, make_file_name
from hrl_escape.planning.props import get_prop_poses
from hrl_escape.text.recordings import record_game, save_games
from hrl_escape.text.session import RoomSession
from hrl_escape.text.told_env import ToolCall

_HELP = ('An option by its name, such as "press button-1" or "leave"; a primitive with how often, such as "forward 3"; '
        '"look", "map", "save", "quit"')
MOST_ROWS, LONGEST_LINE = 36, 4000


def read_command(line: str, tools: Sequence[Mapping[str, Any]]) -> ToolCall | None:
    """The call that a line means; None where it means none.

    Args:
        line: an option, or the beginning of just one; a primitive, with a number of times; or `look`.
        tools: schemas of the session.
    """
    word, _, times = line.partition(" ")
    if line == "look":
        return ToolCall("look", {})
    choices = {tool["name"]: tool["inputSchema"]["properties"] for tool in tools}
    primitive = _complete(word, choices["move"]["primitive"]["enum"] if "move" in choices else ())
    option = None if primitive == word else _complete(line, choices["run_option"]["option"]["enum"])
    if option is not None:
        return ToolCall("run_option", {"option": option})
    if primitive is not None and (not times or times.isdecimal()):
        return ToolCall("move", {"primitive": primitive, "times": int(times[:6] or 1)})
    return None


def _complete(beginning: str, names: Sequence[str]) -> str | None:
    found = [name for name in names if name.startswith(beginning)]
    return beginning if beginning in found else found[0] if len(found) == 1 else None


def play_in_terminal(session: RoomSession, seed: int, folder: Path) -> None:
    """Play one game until it is over, `quit` or the end of the input.

    Args:
        session: about the room.
        seed: of the episode.
        folder: for games that are saved.
    """
    console = Console(highlight=False, soft_wrap=True)
    live = sys.stdin.isatty() and console.is_terminal
    states: list[RoomState] = []

    def show_map() -> None:
        size = shutil.get_terminal_size((80, 30))
        room = session.env.instance
        rows = min(size.lines - 6, MOST_ROWS)
        console.print(draw_map(room, states, Kinematics(room), size.columns - 1, rows), end="")

    def say(text: str) -> None:
        states.append(session.env.state)
        if live:
            show_map()
        for line in text.splitlines():
            console.print(make_console_text(line, LONGEST_LINE))

    say(session.reset(seed))
    console.print(_HELP, style="dim", markup=False)
    for line in sys.stdin:
        word = " ".join(line.split())
        if word == "quit":
            break
        if word == "map":
            show_map()
        elif word == "save":
            console.print(f"Saved as {_save(session, folder)}", markup=False)
        elif (call := read_command(word, session.tools())) is None:
            console.print(_HELP, style="dim", markup=False)
        else:
            say(session.call(*call).text)
    score = session.score()
    console.print(f"{count_nouns(score.primitives, 'primitive')} in {count_nouns(score.decisions, 'call')}, "
                  f"return {score.reward:g}, efficiency {score.efficiency:.2f}")


def _save(session: RoomSession, folder: Path) -> Path:
    """Write the game so far; `RecordedModel` plays it again."""
    game = record_game(session)
    name = make_file_name(f"{game.room.name}-{game.room.seed}-{game.score.primitives}-primitives")
    save_games(folder / f"{name}.jsonl", [game])
    return folder / f"{name}.jsonl"


# --- the map in letters ---------------------------------------------------------------------

_ARROWS = "\N{RIGHTWARDS ARROW}\N{NORTH EAST ARROW}\N{UPWARDS ARROW}\N{NORTH WEST ARROW}" \
          "\N{LEFTWARDS ARROW}\N{SOUTH WEST ARROW}\N{DOWNWARDS ARROW}\N{SOUTH EAST ARROW}"
_WALL, _OBSTACLE = ("\N{FULL BLOCK}", "#7b818c"), ("\N{MEDIUM SHADE}", palette.OBSTACLE_EDGE)
_DOOR, _TRAIL = ("\N{DARK SHADE}", palette.DOOR), ("\N{MIDDLE DOT}", palette.TRAIL)
_BLOCK, _PLATE = ("\N{BLACK SQUARE}", palette.PROP), ("\N{WHITE SQUARE}", palette.PROP)


def draw_map(instance: RoomInstance, states: list[RoomState], rules: Rules, columns: int, rows: int) -> Text:
    """Draw the room from above at the last state, with the way there as dots.

    A character counts as half as wide as high.

    Args:
        instance: the room.
        states: the episode so far.
        rules: rules of the room.
        columns: maximum number of characters in a line.
        rows: maximum number of lines.
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
                cells[row][column] = ("\N{LIGHT SHADE}", palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED)
            for solid in instance.solids:
                if compute_distance(x, y, solid.footprint) <= reach:
                    cells[row][column] = _WALL if solid.role == "wall" else _OBSTACLE
            if instance.door is not None and not is_open and compute_distance(x, y, instance.door.footprint) <= reach:
                cells[row][column] = _DOOR
    for past in states[:-1]:
        put(past.x, past.y, *_TRAIL)
    for placed, (x, y, _) in zip(instance.props, get_prop_poses(state, instance), strict=True):
        put(x, y, *(_BLOCK if placed.prop.kind == "block" else _PLATE))
    for index, target in enumerate(instance.targets):
        look = palette.get_target_look(puzzle, state.puzzle, index)
        for n in range(-8, 9):
            put(target.x + n / 8 * target.half_x * math.cos(target.yaw),
                target.y + n / 8 * target.half_x * math.sin(target.yaw), " ", f"{look.ink} on {look.fill}")
        for n, character in enumerate(target.name.rpartition("-")[2]):
            put(target.x + n * size / 2, target.y, character, f"bold {look.ink} on {look.fill}")
    shut = get_trait(puzzle, Barring).get_shut(state.puzzle)
    for number, door in enumerate(instance.inner_doors):
        if shut >> number & 1:
            put(door.x, door.y, *(_DOOR if door.role == "door" else _BLOCK))
    ground = palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED
    put(*instance.exit.centre, "E", f"bold {palette.EXIT_INK} on {ground}")
    arrow = _ARROWS[round(rules.get_heading(state) / (math.pi / 4)) % 8]
    put(state.x, state.y, arrow, f"bold white on {palette.BODY}")
    text = Text()
    for line in cells:
        for character, style in line:
            text.append(character, style)
        text.append("\n")
    return text
