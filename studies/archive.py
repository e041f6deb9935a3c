"""Archive exploration of one room: return to a cell, explore from it (Go-Explore's first phase, Ecoffet et al. 2021).

A cell is a rounded pose and what is lit; the archive holds the shortest known way to each, the whole state at its end,
and how often exploration began there since that way was found. What it has learned is the shortest escape it knows: its
moves, played from the start without looking. That is a policy only where moves never err.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from hrl_escape.env.poses import RoomState

__all__ = ["ArchiveSettings", "Exploration", "explore"]

Moves = tuple[Any, ...] | None
"""A way as its last move and the way before it, or None for no move."""


@dataclass(frozen=True)
class ArchiveSettings:
    """Cells, exploration and return.

    Attributes:
        cell: width of a cell, m.
        headings: distinct headings over a full turn.
        steps: primitives of an exploration.
        repeat: probability that a primitive of it is the one before.
        returns: `state` puts the robot into the cell, which costs no primitive and is a privilege; `moves` plays the
            cell's moves from the start, which costs them.
    """

    cell: float = 2.0
    headings: int = 4
    steps: int = 30
    repeat: float = 0.8
    returns: Literal["state", "moves"] = "state"


class Exploration(NamedTuple):
    """Result of exploring a room.

    Attributes:
        primitives: run in all, without evaluations.
        first_escape: primitives at its end, or None without one.
        lengths: (primitives, length of the shortest known escape or None) at each evaluation.
        moves: of the shortest escape.
    """

    primitives: int
    first_escape: int | None
    lengths: tuple[tuple[int, int | None], ...]
    moves: tuple[int, ...]


class _Archive:
    """Cells by number: the way to each, its length, the state there, and a weight for the choice."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self._numbers: dict[Any, int] = {}
        self.ways: list[tuple[int, Moves, RoomState]] = []
        self._chosen = np.zeros(1_024)

    def add(self, cell: Any, length: int, moves: Moves, state: RoomState) -> None:
        """Keep a way to a new cell, or a shorter way to a known one; the cell then counts as new."""
        number = self._numbers.setdefault(cell, len(self.ways))
        if number == len(self.ways):
            self.ways.append((length, moves, state))
            if number == len(self._chosen):
                self._chosen = np.concatenate([self._chosen, np.zeros(number)])
        elif length < self.ways[number][0]:
            self.ways[number] = length, moves, state
            self._chosen[number] = 0

    def choose(self) -> tuple[int, Moves, RoomState]:
        """Draw a cell with probability proportional to 1 / sqrt(times chosen + 1), and count the choice."""
        sums = np.cumsum(1 / np.sqrt(self._chosen[: len(self.ways)] + 1))
        number = int(np.searchsorted(sums, self.rng.random() * sums[-1], side="right"))
        self._chosen[number] += 1
        return self.ways[number]


def explore(env: Any, settings: ArchiveSettings, seed: int, budget: int, eval_every: int, enough: int = 0,
            until_escape: bool = False) -> Exploration:
    """Explore a room until the budget is spent, or what is known is enough at two evaluations in a row.

    Args:
        env: `EscapeRoom` without noise, whose episodes begin in one state.
        settings: of the archive.
        seed: fixes the exploration.
        budget: primitives.
        eval_every: primitives between evaluations.
        enough: length of an escape that is.
        until_escape: end with the first escape.
    """
    env.reset(seed=0)
    start, archive = env.get_state(), _Archive(seed)
    archive.add(_find_cell(env, start, settings), 0, None, start)
    primitives, first, best, shortest = 0, None, None, None
    lengths: list[tuple[int, int | None]] = [(0, None)]
    while primitives < budget and not (until_escape and first):
        length, moves, state = archive.choose()
        if settings.returns == "state":
            env.set_state(state)
        else:
            env.set_state(start)
            for move in _unroll(moves):
                env.step(move)
            primitives += length
        for move in _draw_moves(archive.rng, env.action_space.n, settings):
            _, _, terminated, truncated, info = env.step(move)
            primitives, length, moves = primitives + 1, length + 1, (move, moves)
            if terminated or truncated:
                if info["is_success"]:
                    first = first or primitives
                    if shortest is None or length < shortest:
                        best, shortest = moves, length
                break
            archive.add(_find_cell(env, env.get_state(), settings), length, moves, env.get_state())
        if primitives // eval_every > lengths[-1][0] // eval_every or primitives >= budget or (until_escape and first):
            lengths.append((primitives, shortest))
            if all(known is not None and known <= enough for _, known in lengths[-2:]):
                break
    return Exploration(primitives, first, tuple(lengths), tuple(_unroll(best)))


def _find_cell(env: Any, state: RoomState, settings: ArchiveSettings) -> Any:
    turn = int(settings.headings * state.heading_steps * env.instance.robot.turn_step_deg / 360)
    return round(state.x / settings.cell), round(state.y / settings.cell), turn, state.puzzle


def _draw_moves(rng: np.random.Generator, actions: int, settings: ArchiveSettings) -> Iterator[int]:
    moves, stays = rng.integers(actions, size=settings.steps).tolist(), rng.random(settings.steps) < settings.repeat
    last = moves[0]
    for move, stay in zip(moves, stays.tolist(), strict=True):
        last = last if stay else move
        yield last


def _unroll(moves: Moves) -> list[int]:
    unrolled = []
    while moves is not None:
        move, moves = moves
        unrolled.append(move)
    return unrolled[::-1]
