"""Thousands of Escape Rooms as one TorchRL environment over the batched engine.

It is batch-locked: its batch size is (num_envs,). Rules and observations equal those in `vector_env.py`. Tensors stay
on the device of the rooms, and resets follow TorchRL's `_reset` masks.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from typing_extensions import Unpack

from hrl_escape.env.batched.engine import TensorRoom, draw_seed
from hrl_escape.env.batched.rooms import RoomArguments
from hrl_escape.env.presets import ConfigForm
from hrl_escape.env.vector_env import BatchVectorEnv, EscapeRoomVectorEnv

_ENDS = ("done", "terminated", "truncated")
Vector = TypeVar("Vector", bound=BatchVectorEnv)


class BatchTorchRLEnv(EnvBase, Generic[Vector]):
    """Base class of TorchRL environments over the batched engine: specs, seeds, and resets by mask.

    `set_seed(n)` seeds room i with n + i at its next reset. Without it, the system's entropy seeds the rooms.

    Args:
        rooms: vector environment with tensor output and resets disabled.
        shown: specs of the keys in addition to the observation.
    """

    def __init__(self, rooms: Vector, shown: dict[str, Any]) -> None:
        super().__init__(device=rooms.device, batch_size=(rooms.num_envs,))
        self.rooms, self._first_seed = rooms, draw_seed()
        self._awaits_seed = torch.ones(rooms.num_envs, dtype=torch.bool, device=rooms.device)
        self._is_over = torch.zeros_like(self._awaits_seed)
        space: Any = rooms.single_observation_space
        low, high = (torch.from_numpy(side).expand(rooms.num_envs, -1) for side in (space.low, space.high))
        batch: dict[str, Any] = {"shape": self.batch_size, "device": self.device}
        column: dict[str, Any] = {"shape": (*self.batch_size, 1), "device": self.device}
        self.observation_spec = Composite(
            observation=Bounded(low=low, high=high, dtype=torch.float32, device=self.device), **shown, **batch)
        actions: Any = rooms.single_action_space
        self.action_spec = Categorical(int(actions.n), dtype=torch.int64, **batch)
        self.reward_spec = Unbounded(dtype=torch.float32, **column)
        self.done_spec = Composite({name: Binary(n=1, dtype=torch.bool, **column) for name in _ENDS}, **batch)

    @abstractmethod
    def _show(self, info: dict[str, Any]) -> dict[str, Tensor]:
        """Return the values of the keys in `shown`."""

    def _get_reward(self, reward: Tensor, info: dict[str, Any]) -> Tensor:
        return reward

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        where = None if tensordict is None else tensordict.get("_reset", None)
        where = torch.ones_like(self._awaits_seed) if where is None else where.reshape(-1)
        observation, info = torch.empty(0), {}
        for mask, seed in ((where & self._awaits_seed, self._first_seed), (where & ~self._awaits_seed, None)):
            if bool(mask.any()):
                observation, info = self.rooms.reset(seed=seed, options=None if mask.all() else {"reset_mask": mask})
        self._awaits_seed = self._awaits_seed & ~where
        ended = self._is_over & ~where
        return self._pack(observation, info, ended, torch.zeros_like(ended))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation, reward, terminated, truncated, info = self.rooms.step(tensordict["action"])
        packed = self._pack(observation, info, terminated, truncated)
        return packed.set("reward", self._get_reward(reward, info).unsqueeze(-1))

    def _pack(self, observation: Tensor, info: dict[str, Any], terminated: Tensor, truncated: Tensor) -> TensorDictBase:
        self._is_over = terminated | truncated
        ends = zip(_ENDS, (self._is_over, terminated, truncated), strict=True)
        return TensorDict({"observation": observation, **self._show(info),
                           **{name: column.unsqueeze(-1) for name, column in ends}},
                          batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._first_seed = draw_seed() if seed is None else int(seed)
        self._awaits_seed = torch.ones_like(self._awaits_seed)


class EscapeRoomTorchRLEnv(BatchTorchRLEnv[EscapeRoomVectorEnv]):
    """Many rooms that step together. `EscapeRoomEnv` describes the task.

    Keys, each with the batch size (num_envs,) in front: `observation` (float32), `action` (int64, categorical),
    `reward` (float32, 1), `done`, `terminated` and `truncated` (bool, 1), `buttons_on` (int8, one per target).
    `terminated` means success, except in puzzles that can fail. `BatchTorchRLEnv` describes the seeds.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        observation: name of a vector observation.
        rooms: `instance`, `instance_seed`, `num_instances`, `resample_instance`, `device` (`to` moves the rooms) and
            `compile`; see `Rooms`.

    Attributes:
        rooms: the rooms as a Gymnasium `VectorEnv`.
    """

    def __init__(self, num_envs: int = 1, config: ConfigForm = "paper-two-button", *, observation: str = "features",
                 **rooms: Unpack[RoomArguments]) -> None:
        given = EscapeRoomVectorEnv(num_envs, config, observation=observation, autoreset_mode="Disabled",
                                    output="torch", **rooms)
        super().__init__(given, {"buttons_on": Binary(shape=torch.Size([num_envs, given.room.layout.targets]),
                                                dtype=torch.int8, device=given.device)})

    @property
    def room(self) -> TensorRoom:
        """The batched engine."""
        return self.rooms.room

    def _show(self, info: dict[str, Any]) -> dict[str, Tensor]:
        return {"buttons_on": info["buttons_on"]}

    def to(self, device: Any) -> EnvBase:
        """Move the rooms and the specs to a device. Returns the environment itself."""
        self.room.to(device)
        self._awaits_seed, self._is_over = self._awaits_seed.to(self.room.device), self._is_over.to(self.room.device)
        return super().to(device)
