"""Runs of the study: a cell, which says what is bought, in a room until its first escape or near the best."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.poses import list_touched
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.options_env import OptionsEnv
from studies.parts.learner import LinearQ, Place, WalkTables, Watched, find_place

__all__ = ["Cell", "LearnerSettings", "Outcome", "play_cell"]

REWARD = 100.0
"""Reward of the escape; every primitive costs 1."""
Walks = Literal["none", "commitment", "learned", "planned"]


@dataclasses.dataclass(frozen=True)
class Cell:
    """Parts that an agent has.

    Attributes:
        walks: `none` (primitives), `commitment` (a primitive for a random number of times), `learned` or `planned`.
        memory: the learner sees what failed under the present lights in this episode.
        structure: presses known to work go before the learner's choice.
        failure: probability that a planned walk fails at its start.
    """

    walks: Walks = "none"
    memory: bool = False
    structure: bool = False
    failure: float = 0.0


@dataclasses.dataclass(frozen=True)
class LearnerSettings:
    """Settings that all cells share.

    Attributes:
        gamma: discount of a primitive.
        rate: step size of the learner's values.
        walk_rate: step size of learned walks.
        epsilon: share of random actions.
        walk_epsilon: share of choices within learned walks that are committed primitives.
        cell: width of a cell of the floor, m.
        headings: distinguished over a full turn.
        commitment: mean number of primitives of a commitment.
        longest: most primitives of a learned walk.
    """

    gamma: float
    rate: float
    walk_rate: float
    epsilon: float
    walk_epsilon: float
    cell: float
    headings: int
    commitment: float
    longest: int


@dataclasses.dataclass(frozen=True)
class Outcome:
    """End of a run.

    Attributes:
        first_escape: primitives at its end; None if none came.
        near_best: primitives after the first of two episodes in a row where the frozen policy needs no more than
            the fewest primitives / 0.9; None if it never does.
    """

    first_escape: int | None
    near_best: int | None


class _Player:
    """An agent with the parts of a cell in a room."""

    def __init__(self, cell: Cell, settings: LearnerSettings, room: RoomInstance, seed: int) -> None:
        self.cell, self.settings = cell, settings
        self._rng = np.random.default_rng([seed, 37])
        self._watched = Watched(EscapeRoomEnv(instance=room))
        self._puzzle: Any = room.puzzle
        self._count, self._targets = self._puzzle.count, room.targets
        self._steps = round(360 / room.robot.turn_step_deg)
        self._primitives = int(self._watched.action_space.n)  # pyright: ignore[reportAttributeAccessIssue]
        self._presses = cell.walks in ("learned", "planned")
        actions = self._count + 1 if self._presses else self._primitives
        self._q = LinearQ(actions, 1 + self._count * (1 + cell.memory), settings.gamma, settings.rate)
        self._walks = WalkTables(self._count + 1, self._primitives, settings.walk_rate)
        self._options = None
        if cell.walks == "planned":
            self._options = OptionsEnv(self._watched, OptionDegradation(failure=cell.failure, seed=seed),
                                       include_primitives=False, discount=settings.gamma)
        self._mask: NDArray[np.bool_] = np.ones(actions, bool)

    @property
    def primitives(self) -> int:
        return self._watched.primitives

    def play(self, budget: float, is_training: bool = True) -> tuple[bool, int]:
        """Play an episode, or to the end of the budget; returns whether it escaped, and its primitives."""
        started = self.primitives
        if self._options is not None:
            _, info = self._options.reset(seed=0)
            self._mask = info["action_mask"].astype(bool)
        else:
            self._watched.reset(seed=0)
        over = escaped = False
        while not over and self.primitives < budget:
            place, bits, legal = self._look()
            action = self._choose(place, bits, legal, is_training)
            before = self.primitives
            over, escaped = self._run(action, is_training)
            if is_training:
                k = self.primitives - before
                worth = -(1 - self.settings.gamma**k) / (1 - self.settings.gamma)
                if escaped:
                    worth += REWARD * self.settings.gamma ** (k - 1)
                else:
                    after, seen, open_ = self._look()
                    worth += self.settings.gamma**k * self._q.compute_values(after, seen)[open_].max()
                self._q.update(place, bits, action, worth)
        return escaped, self.primitives - started

    def _look(self) -> tuple[Place, NDArray[np.float64], NDArray[np.bool_]]:
        """Place, bits and legal actions."""
        lights = self._watched.lights
        bits = [1.0, *((lights >> i & 1) for i in range(self._count))]
        if self.cell.memory:
            failed = self._watched.failed.get(lights, 0)
            bits += [(failed >> i & 1) for i in range(self._count)]
        if not self._presses:
            return self._find_place(), np.array(bits, float), self._mask
        legal = self._mask.copy()
        legal[-1] = self._puzzle.is_solved(self._watched.state.puzzle)
        return (), np.array(bits, float), legal if legal.any() else self._mask

    def _find_place(self) -> Place:
        return find_place(self._watched.state, self.settings.cell, self.settings.headings, self._steps)

    def _choose(self, place: Place, bits: NDArray[np.float64], legal: NDArray[np.bool_], is_training: bool) -> int:
        explores = is_training and self._rng.random() < self.settings.epsilon
        if self.cell.structure:
            known, enabled = self._watched.structure.list_enabled(self._watched.lights, self._puzzle.goal)
            if legal[-1]:
                return self._count
            enabled = [button for button in enabled if legal[button]]
            if enabled and not (known and explores):
                return min(enabled, key=self._measure)
        options = np.flatnonzero(legal)
        if explores:
            return int(self._rng.choice(options))
        values = self._q.compute_values(place, bits)[options]
        return int(self._rng.choice(options[values >= values.max() - 1e-12]))

    def _measure(self, button: int) -> float:
        """Distance to a button: straight, or what its learned walk takes."""
        if self.cell.walks == "learned":
            return float(self._walks.get(self._find_place())[:, button].min())
        state, target = self._watched.state, self._targets[button]
        return math.dist((state.x, state.y), (target.x, target.y))

    def _run(self, action: int, is_training: bool) -> tuple[bool, bool]:
        """Run an action; returns whether the episode is over, and whether it escaped."""
        if self._options is not None:
            _, _, terminated, truncated, info = self._options.step(action)
            self._mask = info["action_mask"].astype(bool)
            return terminated or truncated, bool(info["is_success"])
        if self.cell.walks == "learned":
            return self._walk(action, is_training)
        times = 1 if self.cell.walks == "none" else self._draw_times()
        for _ in range(times):
            _, _, terminated, truncated, info = self._watched.step(action)
            if terminated or truncated:
                return True, bool(info["is_success"])
        return False, False

    def _walk(self, goal: int, is_training: bool) -> tuple[bool, bool]:
        """Walk to a button or out, by the learned costs."""
        here, primitive, times = self._find_place(), 0, 0
        for _ in range(self.settings.longest):
            if times == 0 and is_training and self._rng.random() < self.settings.walk_epsilon:
                primitive, times = int(self._rng.integers(self._primitives)), self._draw_times()
            elif times == 0:
                costs = self._walks.get(here)[:, goal]
                primitive, times = int(self._rng.choice(np.flatnonzero(costs <= costs.min() + 1e-12))), 1
            times -= 1
            _, _, terminated, truncated, info = self._watched.step(primitive)
            there, touched = self._find_place(), self._watched.touched
            if is_training:
                reached = [*list_touched(touched), *([self._count] if info["is_success"] else [])]
                self._walks.learn(here, primitive, there, reached)
            here = there
            if terminated or truncated:
                return True, bool(info["is_success"])
            if touched >> goal & 1:
                break
        return False, False

    def _draw_times(self) -> int:
        """Number of times that a committed primitive is repeated."""
        return int(self._rng.geometric(1 / self.settings.commitment))


def play_cell(cell: Cell, settings: LearnerSettings, room: RoomInstance, seed: int, budget: int,
              fewest: int | None = None, near_budget: int = 0) -> Outcome:
    """Play until the first escape, or the end of the budget; with `fewest` until two episodes near the best.

    Args:
        cell: parts of the agent.
        settings: of its learner.
        room: with buttons.
        seed: of the agent.
        budget: primitives.
        fewest: primitives of the best known escape; None for no evaluations.
        near_budget: primitives that an escaped agent may train for to come near the best.
    """
    player, first, near = _Player(cell, settings, room, seed), None, None
    spent = 0  # in evaluations, which do not count
    while player.primitives - spent < (limit := budget if first is None else near_budget):
        escaped, _ = player.play(limit + spent)
        at = player.primitives - spent
        if not escaped:
            continue
        first = first or at
        if fewest is None:
            break
        before = player.primitives
        reached, length = player.play(math.inf, is_training=False)
        spent += player.primitives - before
        if not reached or length * 0.9 > fewest:
            near = None
        elif near is not None:
            return Outcome(first, near)
        else:
            near = at
    return Outcome(first, None)
