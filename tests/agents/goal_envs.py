"""Environments with goals whose values are known: flipping bits, and a walk along a corridor."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class GoalEnv(gymnasium.Env):
    """Base of the two, which `observe`: reward 0 where the goal is achieved, which ends the episode, else -1."""

    def __init__(self, size: int, actions: int, horizon: int) -> None:
        goal = spaces.Box(0.0, 1.0, (size,), np.float32)
        self.observation_space = spaces.Dict({"observation": goal, "achieved_goal": goal, "desired_goal": goal})
        self.action_space = spaces.Discrete(actions)
        self.size, self.horizon = size, horizon

    def begin(self, state: Any, goal: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        self.state, self.goal, self.spent = state, goal, 0
        return self.observe(), {}

    def end_step(self) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.spent += 1
        seen = self.observe()
        goals = seen["achieved_goal"], seen["desired_goal"]
        terminated = self.compute_terminated(*goals, {})
        return seen, self.compute_reward(*goals, {}), terminated, self.spent >= self.horizon and not terminated, {
            "is_success": terminated}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> float:
        return 0.0 if np.array_equal(achieved_goal, desired_goal) else -1.0

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        return np.array_equal(achieved_goal, desired_goal)


class BitFlip(GoalEnv):
    """`size` bits, of which an action flips one; state and goal are drawn (Andrychowicz et al. 2017, section 3.1)."""

    def __init__(self, size: int) -> None:
        super().__init__(size, size, horizon=size)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        super().reset(seed=seed)
        bits = self.np_random.integers(2, size=(2, self.size)).astype(np.float32)
        while (bits[0] == bits[1]).all():
            bits = self.np_random.integers(2, size=(2, self.size)).astype(np.float32)
        return self.begin(*bits)

    def step(self, action: int) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.state = self.state.copy()
        self.state[action] = 1 - self.state[action]
        return self.end_step()

    def observe(self) -> dict[str, Any]:
        return {"observation": self.state, "achieved_goal": self.state, "desired_goal": self.goal}


class Walk(GoalEnv):
    """Cells in a row; an episode walks from the first cell, one a step, and asks for the last.

    Args:
        cells: cell of the goal.
        horizon: steps until truncation.
        pit: cell in which the episode ends, goal or not; -1 for none.
    """

    def __init__(self, cells: int, horizon: int, pit: int = -1) -> None:
        super().__init__(1, 1, horizon)
        self.cells, self.pit = cells, pit

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        super().reset(seed=seed)
        return self.begin(0, self.cells)

    def step(self, action: int) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.state += 1
        seen, reward, terminated, truncated, info = self.end_step()
        return seen, reward, terminated or self.state == self.pit, truncated and self.state != self.pit, info

    def observe(self) -> dict[str, Any]:
        cell, goal = (np.array([place / self.cells], np.float32) for place in (self.state, self.goal))
        return {"observation": cell, "achieved_goal": cell, "desired_goal": goal}
