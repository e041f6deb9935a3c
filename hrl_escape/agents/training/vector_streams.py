"""Gymnasium's vector environments as streams: the three kinds of automatic reset, masks and durations from `info`.

The state that an episode ended in is a decision's outcome, never the first observation of the next episode, whichever
way the environment resets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from hrl_escape.agents.agent import check_observation, count_actions
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.streams import EndedDecisions, SavedEpisodes, Streams, StreamSource
from hrl_escape.errors import StepContractError

__all__ = ["VectorStreams", "make_streams"]


class VectorStreams:
    """Streams of a vector environment, one decision of each a step.

    `infos` may hold what `make_transition` reads of `info`, as arrays: `action_mask`, and for decisions of several
    primitives `duration` and `discounted_reward`; and `success` where not every terminated episode is one.

    Args:
        env: numpy arrays, or tensors, which stay on their device.
        gamma: discount of `discounted_reward`, where the environment gives one.
    """

    def __init__(self, env: VectorEnv, gamma: float) -> None:
        self._env = env
        self.count, self.gamma = env.num_envs, gamma
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space
        self._actions = count_actions(self.action_space, "train")
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self.observation = self.action_mask = torch.empty(0)
        self._was_over = torch.zeros(self.count, dtype=torch.bool)

    @property
    def device(self) -> torch.device:
        """Device of the environment's tensors; the CPU for arrays."""
        return self.observation.device

    @property
    def is_waiting(self) -> Tensor:
        """All streams but those that reset in the next step, bool (streams,)."""
        return ~self._was_over

    def reset(self, seeds: int) -> None:
        """Begin all episodes anew."""
        observation, infos = self._env.reset(seed=seeds)
        self.observation = self._take(observation)
        self.action_mask = self._read_mask(infos)
        self._was_over = torch.zeros(self.count, dtype=torch.bool, device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one decision in every stream, or the reset that takes its place."""
        before, where = self.observation, self.is_waiting
        given = action if isinstance(before, Tensor) and self._gives_tensors else action.cpu().numpy()
        seen, reward, terminated, truncated, infos = self._env.step(given)
        now, mask = self._take(seen), self._read_mask(infos)
        reward, terminated, truncated = (self._take(part, dtype) for part, dtype in (
            (reward, torch.float32), (terminated, torch.bool), (truncated, torch.bool)))
        over = (terminated | truncated) & where
        reached, reached_mask, final = now, mask, {}
        if self._mode == AutoresetMode.SAME_STEP and "final_obs" in infos:
            final = infos["final_info"]
            reached = self._replace(now, infos["final_obs"], over)
            reached_mask = (self._replace(mask, final["action_mask"], over) if "action_mask" in final else
                            mask | over[:, None])
        elif self._mode == AutoresetMode.DISABLED and bool(over.any()):
            begun, infos_begun = self._env.reset(options={"reset_mask": over if self._gives_tensors else
                                                          over.cpu().numpy()})
            now, mask = self._take(begun), self._read_mask(infos_begun)
        self.observation, self.action_mask = now, mask
        self._was_over = over if self._mode == AutoresetMode.NEXT_STEP else torch.zeros_like(over)
        duration, discounted = self._read_rewards(reward, infos, final, over)
        return EndedDecisions(where, before, action, reward, discounted, duration, reached, reached_mask, terminated,
                          truncated, self._read_success(terminated, final or infos))

    # --- what comes from the environment ---------------------------------------------------

    def _take(self, value: Any, dtype: torch.dtype | None = None) -> Tensor:
        if isinstance(value, Tensor):
            self._gives_tensors = True
            return value if dtype is None else value.to(dtype)
        self._gives_tensors = False
        tensor = torch.tensor(np.asarray(value), dtype=dtype)
        if dtype is None and tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            check_observation(np.asarray(value), "of a step")
        return tensor

    def _replace(self, batch: Tensor, values: Any, where: Tensor) -> Tensor:
        """Copy of a batch with some rows of another, which may be an array of arrays and None."""
        rows = where.nonzero().squeeze(1)
        new = values[rows] if isinstance(values, Tensor) else torch.from_numpy(
            np.stack([np.asarray(values[row]) for row in rows.tolist()]))
        return batch.index_copy(0, rows, new.to(self.device, batch.dtype))

    def _read_mask(self, infos: Mapping[str, Any]) -> Tensor:
        given = infos.get("action_mask")
        if given is None:
            return torch.ones((self.count, self._actions), dtype=torch.bool, device=self.device)
        mask = (given if isinstance(given, Tensor) else torch.from_numpy(np.stack(list(given)))) != 0
        if mask.shape != (self.count, self._actions):
            raise StepContractError(f"infos['action_mask'] has shape {tuple(mask.shape)}; {self.count} environments "
                                    f"of {self._actions} actions need ({self.count}, {self._actions})")
        if mask.device.type == "cpu" and not bool(mask.any(dim=1).all()):
            raise StepContractError("infos['action_mask'] is all zero for an environment: at least one action must "
                                    "always be legal")
        return mask.to(self.device)

    def _read_rewards(self, reward: Tensor, infos: Mapping[str, Any], final: Mapping[str, Any], over: Tensor
                      ) -> tuple[Tensor, Tensor]:
        """Duration k and R of each stream's decision; `final` holds those of decisions that ended an episode."""
        duration, discounted = torch.ones_like(reward, dtype=torch.int64), reward
        for source, rows in ((infos, ~over if final else torch.ones_like(over)), (final, over)):
            if "duration" not in source or not bool(rows.any()):
                continue
            duration = self._replace(duration, self._take(source["duration"]), rows)
            if "discounted_reward" in source:
                discounted = self._replace(discounted, self._take(source["discounted_reward"]), rows)
            elif bool((duration > 1).any()):
                raise StepContractError("decisions ran several primitives but infos has no 'discounted_reward', so "
                                        "their discounted reward is unknown")
        return duration.clamp(min=1), discounted

    def _read_success(self, terminated: Tensor, told: Mapping[str, Any]) -> Tensor:
        """Success of the episodes that ended, as `read_success` has it; `told` is what their last `info` held."""
        name = "is_success" if "is_success" in told else "success"
        if name not in told:
            return terminated
        success, is_told = ((part if isinstance(part, Tensor) else torch.from_numpy(np.array(part, dtype=bool)))
                            .to(self.device, torch.bool)
                            for part in (told[name], told.get(f"_{name}", [True] * self.count)))
        return torch.where(is_told, success, terminated)

    # --- checkpoints -----------------------------------------------------------------------

    def state_dict(self) -> StateTree | None:
        """Running episodes, for environments that can give them."""
        env: Any = self._env.unwrapped
        if not isinstance(env, SavedEpisodes):
            return None
        return {"env": dict(env.state_dict()), "observation": self.observation, "action_mask": self.action_mask,
                "was_over": self._was_over}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken; after a `reset`."""
        env: Any = self._env.unwrapped
        env.load_state_dict(state["env"])
        self.observation, self.action_mask, self._was_over = (
            torch.from_numpy(np.array(state[name])).to(self.device)
            for name in ("observation", "action_mask", "was_over"))


def make_streams(env: VectorEnv | Streams, gamma: float) -> Streams:
    """The streams of a vector environment: its own, or one decision of each a step.

    Args:
        env: the environment, or streams, which stay as they are.
        gamma: the agent's discount per primitive.
    """
    if not isinstance(env, VectorEnv):
        return env
    inner: Any = env.unwrapped
    return inner.get_streams() if isinstance(inner, StreamSource) else VectorStreams(env, gamma)
