"""Observations with the mask of legal actions, under the keys of RLlib and Tianshou."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.errors import ConfigError, UnsupportedSpaceError


class MaskedObservation(gymnasium.Wrapper[dict[str, Any], int, Any, int], gymnasium.utils.RecordConstructorArgs):
    """Dict observations with the mask of legal actions.

    An observation becomes {`key`: observation of the environment, `mask_key`: int8 (n,), 1 for legal actions}. The mask
    is `info["action_mask"]`. Without this entry, every action is legal.

    | library | arguments | reads |
    |---|---|---|
    | RLlib | none | `obs["action_mask"]`, in its `ActionMaskingRLModule` |
    | Tianshou 2 | `key="obs", mask_key="mask"` | `batch.obs.mask`, in its discrete Q-learning policies |

    Args:
        env: environment with `Discrete` actions, such as an `OptionsEnv`.
        key: key of the environment's own observation.
        mask_key: key of the mask.

    Raises:
        UnsupportedSpaceError: the actions are not `Discrete`.
        ConfigError: both keys are the same.
    """

    def __init__(self, env: gymnasium.Env[Any, int], key: str = "observations", mask_key: str = "action_mask") -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, key=key, mask_key=mask_key)
        gymnasium.Wrapper.__init__(self, env)
        if not isinstance(env.action_space, spaces.Discrete):
            raise UnsupportedSpaceError(f"MaskedObservation needs Discrete actions, not {env.action_space}")
        if key == mask_key:
            raise ConfigError("MaskedObservation.mask_key", mask_key, "another key than that of the observation")
        self.key, self.mask_key = key, mask_key
        self._every = np.ones(int(env.action_space.n), np.int8)
        self.observation_space = spaces.Dict({
            key: env.observation_space, mask_key: spaces.Box(0, 1, self._every.shape, np.int8)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment and return its first observation with the mask."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._put(observation, info), info

    def step(self, action: int) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment; the mask belongs to the state reached."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._put(observation, info), reward, terminated, truncated, info

    def _put(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        mask: NDArray[np.int8] = np.array(info.get("action_mask", self._every), np.int8)
        return {self.key: observation, self.mask_key: mask}
