"""Towers of blocks: moves of a gripper, shortest plans, and problems that are drawn or read from PDDL.

A state gives for each block the block below it: itself on the table, or `IN_HAND` while it is held.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from hrl_escape.errors import ConfigError
from hrl_escape.search import find_cheapest_steps

IN_HAND = 15
"""Stands for the hand as the support of a held block."""
MOST_BLOCKS = 12

Towers: TypeAlias = tuple[int, ...]
"""Number of the block below each block; blocks are numbered from 0."""


class TowersGoal(NamedTuple):
    """Demands on towers."""

    on: tuple[tuple[int, int], ...]  # pairs of a block and what it must stand on, itself for the table
    clear: tuple[int, ...] = ()  # blocks on which nothing may stand, and which are not held
    is_free: bool = False  # the hand must be empty


class Problem(NamedTuple):
    """A problem of Blocks World: names of the blocks, their towers at first, and the goal."""

    names: tuple[str, ...]
    start: Towers
    goal: TowersGoal


def find_top(towers: Towers, base: int) -> int | None:
    """Block on top of the tower whose lowest block is `base`; None if that does not stand on the table."""
    if towers[base] != base:
        return None
    above = {below: block for block, below in enumerate(towers) if below != block}
    while base in above:
        base = above[base]
    return base


def list_moves(towers: Towers) -> Iterator[tuple[int, int, Towers]]:
    """List the moves of a gripper, as (1 to grip or -1 to release, lowest block of the tower, towers after it)."""
    held = towers.index(IN_HAND) if IN_HAND in towers else None
    for base in range(len(towers)):
        top = find_top(towers, base)
        if held is None and top is not None:
            yield 1, base, (*towers[:top], IN_HAND, *towers[top + 1:])
        elif held is not None and (top is not None or base == held):
            yield -1, base, (*towers[:held], base if top is None else top, *towers[held + 1:])


def meets_goal(towers: Towers, goal: TowersGoal) -> bool:
    """Return whether towers meet the goal."""
    return (all(towers[block] == below for block, below in goal.on)
            and not any(towers[block] == IN_HAND for block in goal.clear)
            and not any(below in goal.clear and below != block for block, below in enumerate(towers))
            and not (goal.is_free and IN_HAND in towers))


def _count_least(towers: Towers, goal: TowersGoal) -> int:
    """Lower bound of the moves to the goal: blocks that must be moved, gripped and released once each."""
    wanted, known = dict(goal.on), dict[int, bool]()

    def must_move(block: int) -> bool:
        if block not in known:
            below = towers[block]
            known[block] = wanted.get(block, below) != below or (below not in (block, IN_HAND) and must_move(below))
        return known[block]

    if IN_HAND in towers:
        return 2 * sum(map(must_move, range(len(towers)))) - must_move(towers.index(IN_HAND))
    return 2 * sum(map(must_move, range(len(towers))))


def find_fewest_moves(towers: Towers, goal: TowersGoal) -> tuple[tuple[int, int], ...] | None:
    """The fewest moves that lead to a goal, as (1 to grip or -1 to release, lowest block of the tower); None for none.

    A* with the number of blocks that must be moved. Beyond 10,000 states it continues greedily.
    """
    return find_cheapest_steps(
        towers, lambda state: meets_goal(state, goal),
        lambda state: (((grip, base), 1, then) for grip, base, then in list_moves(state)),
        lambda state: _count_least(state, goal))


# --- problems ------------------------------------------------------------------------------


@lru_cache(maxsize=1024)
def _count_towers(loose: int, placed: int) -> int:
    """Number of ways to place `loose` towers that stand nowhere yet, given the number already on the table."""
    if loose == 0:
        return 1
    return _count_towers(loose - 1, placed) * (loose - 1 + placed) + _count_towers(loose - 1, placed + 1)


def sample_towers(count: int, rng: np.random.Generator) -> Towers:
    """Draw towers, each with the same probability (Slaney and Thiebaux 2001).

    Towers are placed one after another, on the table or on another tower.
    """
    towers = list(range(count))
    loose, placed = [(block, block) for block in range(count)], list[int]()  # lowest and top block, top block
    while loose:
        base, top = loose.pop()
        everywhere = _count_towers(len(loose) + 1, len(placed))
        number = int(rng.integers(everywhere)) - _count_towers(len(loose), len(placed) + 1)
        if number < 0:
            placed.append(top)
            continue
        number //= _count_towers(len(loose), len(placed))
        if number < len(loose):
            towers[base], loose[number] = loose[number][1], (loose[number][0], top)
        else:
            towers[base], placed[number - len(loose)] = placed[number - len(loose)], top
    return tuple(towers)


def read_towers(text: str) -> Problem:
    """Read a PDDL problem of the domain with four operators: pick-up, put-down, stack and unstack.

    Raises:
        ConfigError: the text is no PDDL, or no problem of that domain.
    """
    parts = {str(part[0]): part[1:] for part in _read_list(text)[1:] if isinstance(part, list) and part}
    if not {":objects", ":init", ":goal"} <= parts.keys():
        raise ConfigError("puzzle.problem", text, "a PDDL problem with :objects, :init and :goal")
    names = _list_blocks(parts[":objects"])
    if not 1 <= len(names) <= MOST_BLOCKS or len(set(names)) < len(names):
        raise ConfigError("puzzle.problem", names, f"1 to {MOST_BLOCKS} blocks, each named once")
    init = [_read_fact(fact, names) for fact in parts[":init"]]
    (wanted,) = parts[":goal"] if len(parts[":goal"]) == 1 else ([],)
    goals = wanted[1:] if wanted and wanted[0] == "and" else [wanted]
    goal = [_read_fact(fact, names) for fact in goals]
    below = {fact[1]: fact[-1] for fact in init if fact[0] in ("on", "ontable")}
    if sorted(below) != list(range(len(names))) or ("handempty",) not in init:
        raise ConfigError("puzzle.problem", text, "an :init with handempty, and on or ontable once for each block")
    return Problem(names, tuple(below[block] for block in range(len(names))), TowersGoal(
        tuple((fact[1], fact[-1]) for fact in goal if fact[0] in ("on", "ontable")),
        tuple(fact[1] for fact in goal if fact[0] == "clear"), ("handempty",) in goal))


def _read_list(text: str) -> list:
    """Nested lists of the words of an expression in parentheses, in lower case; comments are left out."""
    words = re.findall(r"[()]|[^\s()]+", re.sub(r";[^\n]*", "", text.lower()))
    open_lists: list[list] = [[]]
    for word in words:
        if word == "(":
            open_lists.append([])
        elif word != ")":
            open_lists[-1].append(word)
        elif len(open_lists) > 1:
            done = open_lists.pop()
            open_lists[-1].append(done)
    if len(open_lists) != 1 or len(open_lists[0]) != 1 or not isinstance(open_lists[0][0], list):
        raise ConfigError("puzzle.problem", text, "one PDDL expression, all parentheses closed")
    return open_lists[0][0]


def _list_blocks(objects: list) -> tuple[str, ...]:
    """Names of the objects that are blocks; some versions of the domain have a robot as well."""
    blocks, untyped, words = list[str](), list[str](), iter(map(str, objects))
    for word in words:
        if word != "-":
            untyped.append(word)
        else:
            blocks += untyped if next(words, "") != "robot" else []
            untyped = []
    return (*blocks, *untyped)


def _read_fact(fact: object, names: tuple[str, ...]) -> tuple:
    """A fact with numbers for blocks; a block that is on the table is on itself."""
    counts = {"on": 2, "ontable": 1, "clear": 1, "handempty": 0}
    if isinstance(fact, list) and fact and fact[0] == "handempty":
        return ("handempty",)
    if not isinstance(fact, list) or not fact or counts.get(fact[0]) != len(fact) - 1 or not set(fact[1:]) <= {*names}:
        raise ConfigError("puzzle.problem", fact, f"a fact of {', '.join(counts)} and the blocks {', '.join(names)}")
    return (fact[0], *(names.index(name) for name in fact[1:]))
