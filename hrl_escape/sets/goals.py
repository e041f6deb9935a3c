"""Goal-conditioned rooms: reach a given pattern of targets that are on, or the exit.

Observations have the form of Gymnasium-Robotics' `GoalEnv` (Plappert et al. 2018): `observation`, `achieved_goal` and
`desired_goal`. Reward and termination are functions of the two goals, as hindsight experience replay requires
(Andrychowicz et al. 2017).
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
from hrl_escape.step_info import is_decision

_TRIES = 100


class GoalsEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper that draws a goal for each episode: a pattern of targets that are on, or the exit.

    A pattern is the state of the targets after 1 to `operators` random operators of the room's symbolic model; it
    differs from the state at the start. The exit is one more goal. An episode also ends when its goal is achieved. The
    reward of a step is 0 if the goal is achieved after it, else -1, and `info["is_success"]` holds the same.
    `info["room_reward"]` and `info["room_success"]` hold the room's own reward and success. In a decision of several
    primitives the last primitive has the goal's reward and the others have 0; see `last_rewards`.

    Observations are a Dict of `observation`, `achieved_goal` and `desired_goal`. Goals are float32 (targets + 1,): 1
    for each target that is on and 0 at the end; at the exit 0 for all targets and 1 at the end.

    Args:
        env: a room or a set of rooms, or an `OptionsEnv` over one.
        operators: largest number of operators from the start to a pattern.
        exits: share of the episodes whose goal is the exit, from 0 to 1; with 1 the goal is the room's own.

    Attributes:
        last_rewards: rewards of the primitives of the latest step, in order.

    Raises:
        ConfigError: `operators` is below 1, or `exits` not a share.
    """

    def __init__(self, env: gymnasium.Env, operators: int = 4, exits: float = 0.0) -> None:
        if isinstance(operators, bool) or not isinstance(operators, int) or operators < 1:
            raise ConfigError("operators", operators, "a whole number of at least 1")
        if isinstance(exits, bool) or not isinstance(exits, (int, float)) or not 0 <= exits <= 1:
            raise ConfigError("exits", exits, "a number from 0 to 1")
        RecordConstructorArgs.__init__(self, operators=operators, exits=exits)
        super().__init__(env)
        self._operators, self._exits = operators, exits
        self._desired = self._make_goal((), False)
        self.last_rewards: tuple[float, ...] = ()
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
            UnsupportedError: the goal is a pattern, and no operator of this room changes which targets are on.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        rng = self.env.unwrapped.np_random
        is_exit = self._exits == 1 or (self._exits > 0 and rng.random() < self._exits)
        self._desired = self._make_goal((), True) if is_exit else self._draw_pattern()
        return self._show(observation, False), {**info, "room_success": False, "is_success": False}

    def _draw_pattern(self) -> NDArray[np.float32]:
        unwrapped: Any = self.env.unwrapped
        puzzle, begin, rng = self._room.puzzle, unwrapped.get_state().puzzle, self.env.unwrapped.np_random
        model = self._room.symbolic_model
        for _ in range(_TRIES):
            state = begin
            for _ in range(int(rng.integers(1, self._operators + 1))):
                facts = puzzle.symbolic.get_facts(state)
                able = [op for op in model.operators if op.action != "push" and op.is_applicable(facts)]
                if not able:
                    break
                state = puzzle.update(state, puzzle.symbolic.make_contacts(able[int(rng.integers(len(able)))]))
            if puzzle.get_lit(state) != puzzle.get_lit(begin):
                return self._make_goal(puzzle.get_lit(state), False)
        raise UnsupportedError(f"nothing that can be done in the room {self._room.name!r} changes which of its targets "
                               "are lit, so there are no goals to draw")

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Take an action; achieving the goal ends the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        seen = self._show(observation, terminated and info["is_success"])
        earned = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info))
        is_success = bool(self.compute_terminated(seen["achieved_goal"], seen["desired_goal"], info))
        info = {**info, "room_reward": reward, "room_success": info["is_success"], "is_success": is_success}
        duration = int(info["duration"]) if is_decision(info) else 1
        self.last_rewards = (*(0.0,) * (duration - 1), earned)
        if is_decision(info):
            discounted = self.env.get_wrapper_attr("gamma") ** (duration - 1) * earned
            info |= {"summed_reward": np.float64(earned), "discounted_reward": np.float64(discounted)}
            if "rewards" in info:
                info["rewards"] = self.last_rewards
        return seen, earned, terminated or is_success, truncated and not is_success, info

    def compute_reward(self, achieved_goal: NDArray[np.float32], desired_goal: NDArray[np.float32], info: Any
                       ) -> NDArray[np.float64]:
        """Compute the reward of goals (..., targets + 1): 0 if achieved and desired goal are equal, else -1."""
        return self.compute_terminated(achieved_goal, desired_goal, info).astype(np.float64) - 1

    def compute_terminated(self, achieved_goal: NDArray[np.float32], desired_goal: NDArray[np.float32], info: Any
                           ) -> NDArray[np.bool_]:
        """Compute the termination of goals: true if achieved and desired goal are equal."""
        return np.all(np.asarray(achieved_goal) == np.asarray(desired_goal), axis=-1)

    def _make_goal(self, lit: tuple[bool, ...], is_exit: bool) -> NDArray[np.float32]:
        """Goal vector: a number for each target of the frame, 0 if the room lacks it, and one for the exit."""
        goal = np.zeros(len(self._room.frame.target_names) + 1, dtype=np.float32)
        if is_exit:
            goal[-1] = 1
        else:
            goal[: len(lit)] = lit
        return goal

    def _show(self, observation: Any, has_escaped: bool) -> dict[str, Any]:
        unwrapped: Any = self.env.unwrapped
        achieved = self._make_goal(self._room.puzzle.get_lit(unwrapped.get_state().puzzle), has_escaped)
        return {"observation": observation, "achieved_goal": achieved, "desired_goal": self._desired.copy()}
