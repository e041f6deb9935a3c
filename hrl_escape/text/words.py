"""Plain English for a room: its contents, the effects of its options, and the changes of a decision.

The text contains only what an agent observes: what is lit, what the puzzle shows, whether the exit is open, and
positions to half a metre if places are revealed. Names may come from files; each is quoted, without markup.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.cues import name_cue
from hrl_escape.env.puzzles.mixins import Barring, Cued, Depicted, get_mixin
from hrl_escape.names import join_words
from hrl_escape.options.domain import DomainStep
from hrl_escape.options.meta_actions import AbsentOption
from hrl_escape.options.option import Option
from hrl_escape.planning.props import get_prop_poses

LONGEST, LONGEST_SENTENCE = 60, 400
"""Most characters of a name or of a puzzle's sentence, for input from files."""


def clean(name: str, longest: int = LONGEST) -> str:
    """Return a name without quotation marks, line breaks, markup or confusable letters, and of bounded length."""
    shown = name if len(name) <= longest else f"{name[:longest - 3]}..."
    return re.sub(r"[^A-Za-z0-9 .,:;+#@()/_-]", lambda letter: letter[0].encode("ascii", "backslashreplace").decode()
                  if ord(letter[0]) > 127 else f"\\x{ord(letter[0]):02x}", shown)


def quote(name: str) -> str:
    """Return a name in quotation marks."""
    return f'"{clean(name)}"'


def list_option_names(options: Sequence[Option]) -> dict[str, int]:
    """Return the option's number by its clean name. Options of targets that the room lacks are omitted."""
    named: dict[str, int] = {}
    for number, option in enumerate(options):
        if isinstance(option, AbsentOption):
            continue
        name = clean(option.name)
        named[f"{name} ({number})" if name in named else name] = number
    return named


def place(x: float, y: float) -> str:
    """Return a position to half a metre as text."""
    return f"({round(2 * x) / 2 + 0.0:.1f}, {round(2 * y) / 2 + 0.0:.1f})"


def tell_room(instance: RoomInstance, state: RoomState, has_places: bool,
                  get_heading: Callable[[RoomState], float]) -> str:
    """Describe the room's contents, lights and the puzzle's display, one line each; with positions if `has_places`."""
    puzzle = instance.puzzle

    def locate(x: float, y: float) -> str:
        return f" at {place(x, y)}" if has_places else ""

    lit, depicted, cues = puzzle.get_lit(state.puzzle), get_mixin(puzzle, Depicted), get_mixin(puzzle, Cued).cues
    things = []
    for index, target in enumerate(instance.targets):
        sign = depicted.get_sign(state.puzzle, index)
        things.append(f"{quote(target.name)}{locate(target.x, target.y)}, {'on' if lit[index] else 'off'}"
                      + (f", marked with a {name_cue(cues[index])}" if cues else "")
                      + (f", showing {quote(sign)}" if sign else ""))
    things += [f"{quote(placed.prop.name)}{locate(x, y)}"
               for placed, (x, y, _) in zip(instance.props, get_prop_poses(state, instance), strict=True)]
    shut = get_mixin(puzzle, Barring).get_shut(state.puzzle)
    things += [f"door {number + 1}{locate(door.x, door.y)}, {'shut' if shut >> number & 1 else 'open'}"
               for number, door in enumerate(instance.inner_doors)]
    lines = [f"Exit{locate(*instance.exit.centre)}: {'open' if puzzle.is_solved(state.puzzle) else 'shut'}.",
             f"Here are {'; '.join(things)}.", *_list_said(puzzle, state.puzzle)]
    if has_places:
        degrees = round(get_heading(state) * 57.29577951308232) % 360
        lines.insert(0, f"You are at {place(state.x, state.y)}, facing {degrees} degrees (x east, y north, m).")
    return "\n".join(lines)


def _list_said(puzzle: Puzzle, state: Any) -> list[str]:
    """Sentences of the puzzle, which may contain names from files."""
    return [clean(said, LONGEST_SENTENCE) for said in puzzle.describe(state)]


def tell_changes(instance: RoomInstance, steps: Sequence[DomainStep]) -> list[str]:
    """Return sentences on every press and every visible change, primitive by primitive, in order."""
    return [said for step in steps for said in _describe_primitive(instance, step)]


def _describe_primitive(instance: RoomInstance, step: DomainStep) -> Iterable[str]:
    puzzle, was, now, events = instance.puzzle, step.state.puzzle, step.next_state.puzzle, step.events
    names = [quote(target.name) for target in instance.targets]
    pressed, on, off = ([names[i] for i in list_touched(bits)]
                        for bits in (events.pressed, events.turned_on, events.turned_off))
    if was == now:
        return [f"Pressed {join_words(pressed)}: nothing changed."] if pressed else []
    changes = ["it " + word if each == pressed else f"{join_words(each)} {word}"
               for each, word in ((on, "came on"), (off, "went out")) if each]
    changes += ["all lights are out"] if len(off) > 1 and not any(puzzle.get_lit(now)) else []
    sign = get_mixin(puzzle, Depicted).get_sign
    changes += [f"{name} now shows {quote(sign(now, i) or 'nothing')}" for i, name in enumerate(names)
                if sign(was, i) != sign(now, i)]
    changes += [said[0].lower() + said[1:].rstrip(".") for said in _list_said(puzzle, now)
                if said not in _list_said(puzzle, was)]
    for number in list_touched(events.opened | events.closed):
        changes.append(f"door {number + 1} {'opened' if events.opened >> number & 1 else 'shut'}")
    if puzzle.is_solved(was) != puzzle.is_solved(now):
        changes.append("the exit opened" if puzzle.is_solved(now) else "the exit shut")
    if events.failed:
        changes.append("the puzzle is failed")
    said = "; ".join(changes) or "nothing changed"
    return [f"Pressed {join_words(pressed)}: {said}." if pressed else f"{said[0].upper()}{said[1:]}."]
