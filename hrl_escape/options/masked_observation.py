"""Observations with their mask inside, as RLlib's and Tianshou's masked policies read them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedSpaceError


class MaskedObservation(gymnasium.Wrapper[dict[str, Any], int, Any, int], gymnasium.utils.RecordConstructorArgs):
    """Observations {`key`: what the environment shows, `action_mask`: int8 (n,), 1 where an action is legal}.

    The mask is that of `info`, which stays there; an environment that gives none has only legal actions.

    Args:
        env: with `Discrete` actions, such as an `OptionsEnv`.
        key: name of the environment's own observation: RLlib says `observations`, Tianshou `obs`.

    Raises:
        UnsupportedSpaceError: the actions are not `Discrete`.
    """

    def __init__(self, env: gymnasium.Env[Any, int], key: str = "observations") -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, key=key)
        gymnasium.Wrapper.__init__(self, env)
        if not isinstance(env.action_space, spaces.Discrete):
            raise UnsupportedSpaceError(f"a mask says which of Discrete actions are legal, not of {env.action_space}")
        self.key, self._every = key, np.ones(int(env.action_space.n), np.int8)
        self.observation_space = spaces.Dict({
            key: env.observation_space, "action_mask": spaces.Box(0, 1, self._every.shape, np.int8)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[dict[str, Any], dict[str, Any]]:
        """First observation of an episode, with its mask."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._put(observation, info), info

    def step(self, action: int) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """One step; the mask is that of the next decision."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._put(observation, info), reward, terminated, truncated, info

    def _put(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        mask: NDArray[np.int8] = np.array(info.get("action_mask", self._every), np.int8)
        return {self.key: observation, "action_mask": mask}
