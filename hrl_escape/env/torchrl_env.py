"""Thousands of Escape Rooms as one TorchRL environment over the batched engine.

It is batch-locked: its batch size is (num_envs,). Rules and observations are those of
`vector_env.py`; tensors stay on its device, and resets follow TorchRL's `_reset` masks instead
of Gymnasium's modes.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from typing_extensions import Unpack

from hrl_escape.env.batched.engine import TensorRoom, draw_seed
from hrl_escape.env.batched.rooms import RoomArguments, Rooms
from hrl_escape.env.sampling.sources import SchematicForm


class EscapeRoomTorchRLEnv(EnvBase):
    """Many rooms that step together; see `EscapeRoomEnv` for the task itself.

    Keys, all with the batch size (num_envs,) in front: `observation` (float32), `action` (int64, categorical),
    `reward` (float32, 1), `done`, `terminated` and `truncated` (bool, 1), `buttons_on` (int8, one a target).
    `terminated` is success, except in puzzles that can be failed.

    `set_seed(n)` seeds room i with n + i at its next reset; without it, seeds come from the system's entropy.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        observation: name of a vector observation.
        rooms: `instance`, `instance_seed`, `num_instances`, `resample_instance`, `device` (`to` moves the rooms) and
            `compile`; see `Rooms`.

    Attributes:
        rooms: the rooms as they were asked for.
        room: the batched engine.
    """

    def __init__(self, num_envs: int = 1, config: SchematicForm = "paper-two-button", *, observation: str = "features",
                 **rooms: Unpack[RoomArguments]) -> None:
        given = Rooms(num_envs, config, observation=observation, **rooms)
        room = TensorRoom(given, autoreset="disabled")
        super().__init__(device=room.device, batch_size=(num_envs,))
        self.rooms, self.room = given, room
        self._first_seed = draw_seed()
        self._awaits_seed = torch.ones(num_envs, dtype=torch.bool, device=room.device)
        low, high = (torch.from_numpy(side).expand(num_envs, -1) for side in (room.low, room.high))
        batch: dict[str, Any] = {"shape": torch.Size([num_envs]), "device": self.device}
        column: dict[str, Any] = {"shape": torch.Size([num_envs, 1]), "device": self.device}
        self.observation_spec = Composite(
            observation=Bounded(low=low, high=high, dtype=torch.float32, device=self.device),
            buttons_on=Binary(shape=torch.Size([num_envs, room.layout.targets]), dtype=torch.int8, device=self.device),
            **batch,
        )
        self.action_spec = Categorical(room.actions, dtype=torch.int64, **batch)
        self.reward_spec = Unbounded(dtype=torch.float32, **column)
        self.done_spec = Composite(
            {name: Binary(n=1, dtype=torch.bool, **column) for name in ("done", "terminated", "truncated")}, **batch
        )

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        where = None if tensordict is None else tensordict.get("_reset", None)
        where = torch.ones_like(self._awaits_seed) if where is None else where.reshape(-1)
        fresh, further = where & self._awaits_seed, where & ~self._awaits_seed
        if bool(fresh.all()):
            observation = self.room.reset(self._make_seeds())
        else:
            if bool(fresh.any()):
                self.room.reset(self._make_seeds(), fresh)
            observation = self.room.reset(where=further)
        self._awaits_seed = self._awaits_seed & ~where
        ended = self.room.state.has_ended != 0
        return self._pack(observation, self.room.inform().buttons_on, ended, torch.zeros_like(ended))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation, reward, terminated, truncated, info, *_ = self.room.step(tensordict["action"])
        packed = self._pack(observation, info.buttons_on, terminated, truncated)
        return packed.set("reward", reward.unsqueeze(-1))

    def _pack(self, observation: torch.Tensor, buttons_on: torch.Tensor, terminated: torch.Tensor,
              truncated: torch.Tensor) -> TensorDictBase:
        return TensorDict(
            {"observation": observation, "buttons_on": buttons_on, "terminated": terminated.unsqueeze(-1),
             "truncated": truncated.unsqueeze(-1), "done": (terminated | truncated).unsqueeze(-1)},
            batch_size=self.batch_size, device=self.device,
        )

    def _set_seed(self, seed: int | None) -> None:
        self._first_seed = draw_seed() if seed is None else int(seed)
        self._awaits_seed = torch.ones_like(self._awaits_seed)

    def _make_seeds(self) -> torch.Tensor:
        return torch.arange(self.room.count, device=self.device) + self._first_seed

    def to(self, device: Any) -> EnvBase:
        """Move the rooms and the specs; returns itself."""
        self.room.to(device)
        self._awaits_seed = self._awaits_seed.to(self.room.device)
        return super().to(device)
