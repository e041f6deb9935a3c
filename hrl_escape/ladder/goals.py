"""Goals: a room as a task of reaching given patterns of lit targets, in the form that goal-conditioned learners read.

The Dict view of Gymnasium-Robotics' `GoalEnv` (Plappert et al. 2018), which hindsight experience replay (Andrychowicz
et al. 2017) relabels: `observation`, `achieved_goal`, `desired_goal`, and a reward that is a function of the two goals.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError, UnsupportedError

__all__ = ["GoalsEnv"]

_TRIES = 100


class GoalsEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Asks for a pattern of lit targets that the episode draws, in place of the exit.

    A goal is what is lit after 1 to `operators` operators of the room's symbolic model, drawn at random; one that
    differs from what is lit at the start. The episode ends when it is achieved, as it ends at the horizon and wherever
    the room ends it. The reward of a step is 0 if the goal is achieved after it, else -1; `info["is_success"]` says
    which, and `info["room_reward"]` keeps the room's own reward.

    Observations are a Dict of the observation, and of `achieved_goal` and `desired_goal`: 1 for each target that is
    lit, or is to be, float32 (targets,).

    Args:
        env: a room or a set of rooms, or an `OptionsEnv` over one.
        operators: most operators that a goal is away from the start.

    Raises:
        ConfigError: no operators at all.
    """

    def __init__(self, env: gymnasium.Env, operators: int = 4) -> None:
        if isinstance(operators, bool) or not isinstance(operators, int) or operators < 1:
            raise ConfigError("operators", operators, "a whole number of at least 1")
        RecordConstructorArgs.__init__(self, operators=operators)
        super().__init__(env)
        self._operators = operators
        self._desired = np.zeros(len(self._room.frame.target_names), dtype=np.float32)
        goal = spaces.Box(0.0, 1.0, self._desired.shape, np.float32)
        self.observation_space = spaces.Dict(
            {"observation": env.observation_space, "achieved_goal": goal, "desired_goal": goal})

    @property
    def _room(self) -> RoomInstance:
        room: Any = self.env.unwrapped
        return room.instance

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode with a new goal.

        Raises:
            UnsupportedError: nothing that can be done in this room changes what is lit.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._desired = self._draw_goal()
        return self._show(observation), {**info, "is_success": False}

    def _draw_goal(self) -> NDArray[np.float32]:
        unwrapped: Any = self.env.unwrapped
        puzzle, begin, rng = self._room.puzzle, unwrapped.get_state().puzzle, self.env.unwrapped.np_random
        model = self._room.symbolic_model
        for _ in range(_TRIES):
            state = begin
            for _ in range(int(rng.integers(1, self._operators + 1))):
                facts = puzzle.get_facts(state)
                able = [op for op in model.operators if op.action != "push" and op.is_applicable(facts)]
                if not able:
                    break
                state = puzzle.update(state, puzzle.make_contacts(able[int(rng.integers(len(able)))]))
            if puzzle.get_lit(state) != puzzle.get_lit(begin):
                return self._spread(puzzle.get_lit(state))
        raise UnsupportedError(f"nothing that can be done in the room {self._room.name!r} changes which of its targets "
                               "are lit, so there are no goals to draw")

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Act; achieving the goal ends the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        seen = self._show(observation)
        earned = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info))
        is_success = earned == 0.0
        info = {**info, "room_reward": reward, "is_success": is_success}
        return seen, earned, terminated or is_success, truncated and not is_success, info

    def compute_reward(self, achieved_goal: NDArray[np.float32], desired_goal: NDArray[np.float32], info: Any
                       ) -> NDArray[np.float64]:
        """Reward of a step after which a goal was achieved and another one desired: 0 where they are equal, else -1.

        Args:
            achieved_goal: float32 (..., targets).
            desired_goal: float32 (..., targets).
            info: not looked at.
        """
        return -np.any(np.asarray(achieved_goal) != np.asarray(desired_goal), axis=-1).astype(np.float64)

    def _spread(self, lit: tuple[bool, ...]) -> NDArray[np.float32]:
        """One number a target of the frame; those that this room lacks are never lit."""
        goal = np.zeros(len(self._room.frame.target_names), dtype=np.float32)
        goal[: len(lit)] = lit
        return goal

    def _show(self, observation: Any) -> dict[str, Any]:
        unwrapped: Any = self.env.unwrapped
        lit = self._room.puzzle.get_lit(unwrapped.get_state().puzzle)
        return {"observation": observation, "achieved_goal": self._spread(lit), "desired_goal": self._desired.copy()}
