"""Rooms with options as TorchRL environments, and a transform that passes durations to TorchRL's losses.

    env = OptionsTorchRLEnv(64, "paper-two-button")
    data = Collector(env, policy, ..., postproc=SMDPTransform())

TorchRL's value estimators discount by gamma to the power of `steps_to_next_obs` at the root of the data, and ignore
this key under `next`. An environment returns a duration with the next observation, so `SMDPTransform` copies it.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Unbounded
from torchrl.envs import Transform

from hrl_escape.env.torchrl_env import BatchTorchRLEnv
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

DURATION, STEPS = "duration", "steps_to_next_obs"


class OptionsTorchRLEnv(BatchTorchRLEnv[OptionsVectorEnv]):
    """Batch of rooms with one decision per room and step; see `OptionsEnv` for the task and the actions.

    It is batch-locked. Rooms are seeded as in `BatchTorchRLEnv`. All keys have the batch size (num_envs,) in front:

    - `observation`: float32
    - `action_mask`: bool (actions,)
    - `action`: int64, categorical
    - `duration`: int64 (1,), primitives of the decision that led here, 0 after a reset
    - `reward`: float32 (1,), the discounted sum of the decision's rewards
    - `done`, `terminated`, `truncated`: bool (1,)

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        arguments: further arguments of `BatchedOptionsEnv`, such as `discount`, `observation` and `device`.

    Attributes:
        rooms: the rooms as a Gymnasium `VectorEnv`.
    """

    def __init__(self, num_envs: int = 1, config: Any = "paper-two-button", **arguments: Any) -> None:
        rooms = OptionsVectorEnv(num_envs, config, autoreset_mode="Disabled", output="torch", **arguments)
        masks, durations = (torch.Size([num_envs, numbers]) for numbers in (len(rooms.action_names), 1))
        super().__init__(rooms, {"action_mask": Binary(shape=masks, dtype=torch.bool, device=rooms.device),
                                 DURATION: Unbounded(shape=durations, dtype=torch.int64, device=rooms.device)})

    def _show(self, info: dict[str, Any]) -> dict[str, Tensor]:
        return {"action_mask": info["action_mask"], DURATION: info["duration"].to(torch.int64).unsqueeze(-1)}

    def _get_reward(self, reward: Tensor, info: dict[str, Any]) -> Tensor:
        return info["discounted_reward"].to(torch.float32)


class SMDPTransform(Transform):
    """Copies the duration of each decision to `steps_to_next_obs`, where TorchRL's value estimators read it.

    Use it on data: as `postproc` of a collector or `transform` of a replay buffer. `DQNLoss`, `DiscreteSACLoss`, `GAE`
    and other losses then discount decisions of k primitives by gamma^k. The reward must be the discounted sum over the
    decision, at the same gamma.

    Args:
        duration: key under `next` with the number of primitives, int (..., 1).
    """

    def __init__(self, duration: str = DURATION) -> None:
        super().__init__(in_keys=[("next", duration)], out_keys=[STEPS])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Copy the durations of a batch of any shape."""
        return tensordict.set(STEPS, tensordict.get(self.in_keys[0]))
