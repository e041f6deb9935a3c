"""Rooms with options as TorchRL environments, and the transform by which TorchRL's losses see durations.

    env = OptionsTorchRLEnv(64, "paper-two-button")
    data = Collector(env, policy, ..., postproc=SMDPTransform())

TorchRL's value estimators discount by gamma to the power of `steps_to_next_obs` beside the observation, and ignore the
same key under `next`. An environment can only know a decision's duration after it, so `SMDPTransform` brings it there.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, Transform

from hrl_escape.env.batched.engine import draw_seed
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

DURATION, STEPS = "duration", "steps_to_next_obs"


class OptionsTorchRLEnv(EnvBase):
    """Many rooms in which a step is one decision of each; see `OptionsEnv` for the task and the actions.

    It is batch-locked. Keys, all with the batch size (num_envs,) in front: `observation` (float32), `action_mask`
    (bool, one an action), `action` (int64, categorical), `duration` (int64, 1: primitives of the decision that led
    here, 0 after a reset), `reward` (float32, 1: the discounted sum of the decision's rewards), `done`, `terminated`
    and `truncated` (bool, 1).

    `set_seed(n)` seeds room i with n + i at the next reset of all; without it, seeds come from the system's entropy.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        arguments: all other arguments of `BatchedOptionsEnv`, such as `discount`, `observation` and `device`.

    Attributes:
        rooms: the rooms as a Gymnasium `VectorEnv`.
    """

    def __init__(self, num_envs: int = 1, config: Any = "paper-two-button", **arguments: Any) -> None:
        rooms = OptionsVectorEnv(num_envs, config, autoreset_mode="Disabled", output="torch", **arguments)
        super().__init__(device=rooms.device, batch_size=(num_envs,))
        self.rooms = rooms
        self._seed: int | None = None
        space: Any = rooms.single_observation_space
        low, high = (torch.from_numpy(side).expand(num_envs, -1) for side in (space.low, space.high))
        actions = len(rooms.action_names)
        batch: dict[str, Any] = {"shape": torch.Size([num_envs]), "device": self.device}
        column: dict[str, Any] = {"shape": torch.Size([num_envs, 1]), "device": self.device}
        self.observation_spec = Composite(
            observation=Bounded(low=low, high=high, dtype=torch.float32, device=self.device),
            action_mask=Binary(shape=torch.Size([num_envs, actions]), dtype=torch.bool, device=self.device),
            **{DURATION: Unbounded(dtype=torch.int64, **column)}, **batch,
        )
        self.action_spec = Categorical(actions, dtype=torch.int64, **batch)
        self.reward_spec = Unbounded(dtype=torch.float32, **column)
        self.done_spec = Composite(
            {name: Binary(n=1, dtype=torch.bool, **column) for name in ("done", "terminated", "truncated")}, **batch)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        where = None if tensordict is None else tensordict.get("_reset", None)
        given: dict[str, Any] = {} if where is None else {"options": {"reset_mask": where.reshape(-1)}}
        seed, self._seed = self._seed, None
        observation, info = self.rooms.reset(seed=seed, **given)
        done = torch.zeros(self.batch_size[0], dtype=torch.bool, device=self.device)
        return self._pack(observation, info, torch.zeros_like(done, dtype=torch.int64), done, done)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation, _, terminated, truncated, info = self.rooms.step(tensordict["action"])
        packed = self._pack(observation, info, info["duration"], terminated, truncated)
        return packed.set("reward", info["discounted_reward"].to(torch.float32).unsqueeze(-1))

    def _pack(self, observation: torch.Tensor, info: dict[str, Any], duration: torch.Tensor, terminated: torch.Tensor,
              truncated: torch.Tensor) -> TensorDictBase:
        columns = {DURATION: duration.to(torch.int64), "terminated": terminated, "truncated": truncated,
                   "done": terminated | truncated}
        return TensorDict({"observation": observation, "action_mask": info["action_mask"],
                           **{name: column.unsqueeze(-1) for name, column in columns.items()}},
                          batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._seed = draw_seed() if seed is None else int(seed)


class SMDPTransform(Transform):
    """Write the duration of each decision where TorchRL's value estimators look for it: `steps_to_next_obs`.

    For data: as `postproc` of a collector or `transform` of a replay buffer, not around an environment. With it
    `DQNLoss`, `DiscreteSACLoss`, `GAE` and their like discount decisions of k primitives by gamma^k, whatever
    environment of options they come from. Their reward must be the discounted sum over the decision, at the same gamma.

    Args:
        duration: key under `next` that holds the number of primitives, int (..., 1).
    """

    def __init__(self, duration: str = DURATION) -> None:
        super().__init__(in_keys=[("next", duration)], out_keys=[STEPS])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Copy the durations of a batch of any shape."""
        return tensordict.set(STEPS, tensordict.get(self.in_keys[0]))
