"""Archive exploration of one room: return to a cell, explore from it (Go-Explore's first phase, Ecoffet et al. 2021).

A cell is a rounded pose and what is lit; the archive holds the shortest known way to each, the whole state at its end,
and how often exploration began there since that way was found. It ends with the first escape.
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
        primitives: run in all.
        moves: of the first escape, from the start; empty without one.
    """

    primitives: int
    moves: tuple[int, ...]

    @property
    def first_escape(self) -> int | None:
        """Primitives at its end, or None without one."""
        return self.primitives if self.moves else None


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


def explore(env: Any, settings: ArchiveSettings, seed: int, budget: int) -> Exploration:
    """Explore a room until the first escape, or until the budget is spent.

    Args:
        env: `EscapeRoom` without noise, whose episodes begin in one state.
        settings: of the archive.
        seed: fixes the exploration.
        budget: primitives.
    """
    env.reset(seed=0)
    start, archive, primitives = env.get_state(), _Archive(seed), 0
    archive.add(_find_cell(env, start, settings), 0, None, start)
    while primitives < budget:
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
            if info["is_success"] and (terminated or truncated):
                return Exploration(primitives, tuple(_unroll(moves)))
            if terminated or truncated:
                break
            archive.add(_find_cell(env, env.get_state(), settings), length, moves, env.get_state())
    return Exploration(primitives, ())


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
