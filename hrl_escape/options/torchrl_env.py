"""Environments with options for TorchRL, and a transform that passes durations to TorchRL's losses.

    env = OptionsTorchRLEnv(64, "paper-two-button")  # many rooms
    env = OptionsGymWrapper(OptionsEnv(your_env, your_options))  # any environment with options
    data = Collector(env, policy, ..., postproc=SMDPTransform())

TorchRL's value estimators discount by gamma to the power of `steps_to_next_obs` at the root of the data, and ignore
this key under `next`. An environment returns a duration with the next observation, so `SMDPTransform` copies it.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, TensorSpec, Unbounded
from torchrl.envs import GymWrapper, Transform
from torchrl.envs.gym_like import BaseInfoDictReader

from hrl_escape.env.torchrl_env import BatchTorchRLEnv
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

DURATION, DISCOUNT, STEPS = "duration", "discount", "steps_to_next_obs"


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


class OptionsGymWrapper(GymWrapper):
    """Any environment with options, such as an `OptionsEnv` over your own environment, with one decision per step.

    Observation, `done` and seeds are as in TorchRL's `GymWrapper`. These keys hold the decision, with no batch size:

    - `action`: int64, categorical
    - `action_mask`: bool (actions,), the legal actions
    - `duration`: int64 (1,), primitives of the decision that led here, 0 after a reset
    - `discount`: float32 (1,), gamma^k of it, 1 after a reset
    - `reward`: float32 (1,), the discounted sum of its rewards

    Wrap it in `TransformedEnv(env, ActionMask())` for random rollouts of legal actions. `ParallelEnv` and `SerialEnv`
    run several.

    Args:
        env: environment whose `info` has the keys of `OptionsEnv`; wrappers of Gymnasium may be around it.
        arguments: further arguments of `GymWrapper`, such as `device`.

    Raises:
        UnsupportedError: it has no options.
    """

    def __init__(self, env: gymnasium.Env, **arguments: Any) -> None:
        if not env.has_wrapper_attr("action_names"):
            raise UnsupportedError(f"{env} has no options: wrap it in OptionsEnv(env, options), or use TorchRL's "
                                   "GymWrapper")
        super().__init__(env, categorical_action_encoding=True, **arguments)
        self.set_info_dict_reader(_DecisionReader(len(env.get_wrapper_attr("action_names"))))


class _DecisionReader(BaseInfoDictReader):
    """Copies mask, duration and discounts of a decision from `info`."""

    def __init__(self, actions: int) -> None:
        self._specs = {"action_mask": Binary(actions, dtype=torch.bool),
                       DURATION: Unbounded(shape=torch.Size((1,)), dtype=torch.int64),
                       DISCOUNT: Unbounded(shape=torch.Size((1,)), dtype=torch.float32)}

    def __call__(self, info_dict: dict[str, Any], tensordict: TensorDictBase) -> TensorDictBase:
        for name, spec in self._specs.items():
            value = torch.as_tensor(info_dict[name], dtype=spec.dtype, device=tensordict.device)
            tensordict.set(name, value.reshape(spec.shape))
        if "reward" in tensordict:  # absent after a reset
            tensordict["reward"] = torch.full_like(tensordict["reward"], float(info_dict["discounted_reward"]))
        return tensordict

    @property
    def info_spec(self) -> dict[str, TensorSpec]:
        """Specs of the keys."""
        return dict(self._specs)


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
