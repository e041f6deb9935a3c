"""The package's own puzzles as small SMDPs: real rules, straight lines instead of planners, in microseconds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.making import make_agent
from hrl_escape.benchmark.solved_probe import compare_graphs, find_edges_that_matter
from hrl_escape.env.puzzles.base import Contacts, Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from tests.agents.running import interact


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
        failure: probability that an action fails: one primitive is spent, and nothing happens.
        has_door: the exit's action is masked until the puzzle is solved, and a further action always is.
    """

    def __init__(
        self, puzzle: Puzzle, side: float = 20.0, seed: int = 0, horizon: int = 1_000, anywhere: bool = False,
        failure: float = 0.0, has_door: bool = False,
    ) -> None:
        self.puzzle, self.horizon, self.anywhere, self.failure = puzzle, horizon, anywhere, failure
        self.has_door = has_door
        self.targets = len(puzzle.target_names)
        places = np.random.default_rng(seed).uniform(0, side, (self.targets + 2, 2))
        self.places = np.floor(places) + 0.25
        low, high = np.zeros(2 + self.targets), np.r_[side + 1, side + 1, np.ones(self.targets)]
        self.observation_space = spaces.Box(low, high, dtype=np.float64)
        self.action_space = spaces.Discrete(self.targets + 1 + has_door)

    def observe(self) -> NDArray[np.float64]:
        return np.r_[self.places[self.place], self.puzzle.observe(self.state)]

    def compute_mask(self) -> NDArray[np.int8]:
        """An action is legal unless the robot is at its place, or behind a door."""
        actions = np.arange(self.targets + 1 + self.has_door)
        shut = self.has_door and actions >= self.targets + self.puzzle.is_solved(self.state)
        return ((actions != self.place) & ~shut).astype(np.int8)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.elapsed = self.targets + 1, 0
        self.state: Any = int(self.np_random.integers(2**self.targets)) if self.anywhere else self.puzzle.make_state()
        return self.observe(), {"action_mask": self.compute_mask()}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self.failure and self.np_random.random() < self.failure:
            self.elapsed += 1
            info = {"duration": 1, "rewards": [-1.0], "action_mask": self.compute_mask()}
            return self.observe(), -1.0, False, self.elapsed >= self.horizon, info
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


def make_button_env(kind: Any, buttons: int, rule: Any, seed: int, failure: float = 0.0) -> PuzzleEnv:
    """Buttons with at most two parents each, on a square of 20 m, from 11 buttons on of 30 m."""
    config = ButtonsConfig(count=buttons, graph=GraphConfig(kind=kind, max_parents=2), on_violation=rule)
    puzzle = config.make_puzzle(np.random.default_rng(seed))
    return PuzzleEnv(puzzle, 30.0 if buttons > 10 else 20.0, seed, failure=failure)


class LearnedPuzzle(NamedTuple):
    """What an agent has learned about a puzzle.

    Attributes:
        first_escape: primitives at the end of the first episode that escaped; None if none did.
        precision: of the edges that matter in its graph.
        recall: of those that matter in the puzzle's.
        returns: of its episodes.
    """

    first_escape: int | None
    precision: float
    recall: float
    returns: list[float]


def learn_puzzle(name: str, env: PuzzleEnv, primitives: int, seed: int, **settings: Any) -> LearnedPuzzle:
    """Let an agent that learns a graph play until it has used so many primitives."""
    agent = make_agent(name, env.observation_space, env.action_space, seed, **settings)
    used, first, total, returns = 0, None, 0.0, []
    for step in interact(agent, env, primitives, seed):
        used, total = used + step.duration, total + step.summed_reward
        if step.terminated or step.truncated:
            first = used if first is None and step.terminated else first
            returns.append(total)
            total = 0.0
        if used >= primitives:
            break
    goals = env.puzzle.goal_targets
    edges = {(parent - 2, child - 2) for parent, child in agent.get_graph() or ()}
    shares = compare_graphs(find_edges_that_matter(edges, goals), find_edges_that_matter(env.puzzle.edges, goals))
    return LearnedPuzzle(first, *shares, returns)
