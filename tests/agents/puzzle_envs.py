"""The package's own puzzles as small SMDPs: real rules, straight lines instead of planners, in microseconds."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.env.puzzles.base import Contacts, Puzzle


class PuzzleEnv(gymnasium.Env):
    """One action a target, which goes there and presses it, and one for the exit.

    The observation is x, y (m, off every integer), then the puzzle's bits. Reward -1 a primitive of 1 m, and 100 more
    at the exit once the puzzle is solved.

    Args:
        puzzle: its rules.
        side: of the square in which the places are drawn, metres.
        seed: of the places.
        horizon: primitives until truncation, also inside an action.
        anywhere: begin with random bits instead of the puzzle's first state.
    """

    def __init__(
        self, puzzle: Puzzle, side: float = 20.0, seed: int = 0, horizon: int = 1_000, anywhere: bool = False
    ) -> None:
        self.puzzle, self.horizon, self.anywhere = puzzle, horizon, anywhere
        self.targets = len(puzzle.target_names)
        places = np.random.default_rng(seed).uniform(0, side, (self.targets + 2, 2))
        self.places = np.floor(places) + 0.25
        low, high = np.zeros(2 + self.targets), np.r_[side + 1, side + 1, np.ones(self.targets)]
        self.observation_space = spaces.Box(low, high, dtype=np.float64)
        self.action_space = spaces.Discrete(self.targets + 1)

    def observe(self) -> NDArray[np.float64]:
        return np.r_[self.places[self.place], self.puzzle.observe(self.state)]

    def compute_mask(self) -> NDArray[np.int8]:
        """An action is legal unless the robot is at its place."""
        return (np.arange(self.targets + 1) != self.place).astype(np.int8)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.elapsed = self.targets + 1, 0
        self.state: Any = int(self.np_random.integers(2**self.targets)) if self.anywhere else self.puzzle.make_state()
        return self.observe(), {"action_mask": self.compute_mask()}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        away = math.dist(self.places[self.place], self.places[action])
        duration = min(max(1, math.ceil(away)), self.horizon - self.elapsed)
        self.elapsed += duration
        truncated = self.elapsed >= self.horizon
        rewards = [-1.0] * duration
        terminated = False
        if not truncated:
            self.place = action
            terminated = action == self.targets and self.puzzle.is_solved(self.state)
            if action < self.targets:
                self.state = self.puzzle.update(self.state, Contacts((action,)))
        rewards[-1] += 100.0 * terminated
        info = {"duration": duration, "rewards": rewards, "action_mask": self.compute_mask()}
        return self.observe(), sum(rewards), terminated, truncated, info
