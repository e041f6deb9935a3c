"""Trials: several attempts at one room as one episode, so that what an agent remembers lasts from one to the next.

The formulation of Duan et al. (2016), "RL^2": an agent whose weights do not change can get better within the episode by
its memory alone.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from hrl_escape.errors import ConfigError

__all__ = ["TrialsEnv"]


class TrialsEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Makes an episode of several trials, each from a start of the same room.

    The step that ends a trial shows the start of the next one, and neither terminates nor truncates unless it was the
    last. Wrappers and recurrent agents outside see one episode. `info["trial"]` is the number of a step's trial, from
    0; where it ends the trial `info["trial_ended"]` is true and `info["is_success"]` says whether the robot escaped.

    Args:
        env: a room or a set of rooms, or an `OptionsEnv` over one.
        trials: number of trials in an episode.
    """

    def __init__(self, env: gymnasium.Env, trials: int) -> None:
        if trials < 1:
            raise ConfigError("trials", trials, "1 or more")
        RecordConstructorArgs.__init__(self, trials=trials)
        super().__init__(env)
        self._trials, self._trial = trials, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the first trial in a room."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._trial = 0
        return observation, {**info, "trial": 0}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Act; at the end of a trial the next one begins."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        info = {**info, "trial": self._trial, "trial_ended": terminated or truncated}
        if terminated or truncated:
            info["is_success"] = bool(info.get("is_success", info.get("success", terminated)))
            if self._trial + 1 < self._trials:
                self._trial += 1
                observation, begun = self.env.reset(options=self._find_room())
                info |= {name: begun[name] for name in ("action_mask",) if name in begun}
                terminated = truncated = False
        return observation, reward, terminated, truncated, info

    def _find_room(self) -> dict[str, Any] | None:
        """Reset options that lead to the same room again."""
        room: Any = self.env.unwrapped
        return None if room.instance_index is None else {"instance_index": room.instance_index}
