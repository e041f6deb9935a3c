"""Thousands of rooms with options as one Gymnasium `VectorEnv`: a step is one decision of every room.

`gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=1024)` makes one. A room whose decision has ended
waits for the others. `get_many_envs` returns the same rooms, each at its own pace, as `train` uses them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import unpack_bits
from hrl_escape.env.vector_env import BatchVectorEnv
from hrl_escape.errors import BatchError, UnsupportedError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.batched.stepping import Transitions

_ELSEWHERE = {
    "trace": "rooms keep no list of primitives",
    "discounted_reward": "infos['discounted_reward'] holds it beside the reward",
    "option_features": "infos['action_mask'] tells what is legal",
    "planner": "options follow cost-to-go fields",
}
_TOLD = ("duration", "discount", "discounted_reward", "ended", "primitives")


class OptionsVectorEnv(BatchVectorEnv):
    """Many rooms with one decision per room and step; see `OptionsEnv` for the task and the actions.

    `infos` holds arrays over rooms: `action_mask` (bool); `duration`, `discount`, `summed_reward`, `discounted_reward`
    and `pressed`, as in `OptionsEnv`; `ended` (an index into `ENDINGS`), `primitives` (of the episode so far) and
    `is_success`. At a reset they describe an empty decision. The three kinds of automatic reset are as in
    `EscapeRoomVectorEnv`.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        render_mode: must be None.
        autoreset_mode: `NextStep`, `SameStep` or `Disabled`.
        output: `numpy` arrays, or `torch` tensors on the device.
        max_episode_steps: maximum number of decisions of an episode, as `gymnasium.make` counts them, or None for the
            room's horizon alone.
        arguments: further arguments of `BatchedOptionsEnv`.

    Raises:
        UnsupportedError: `render_mode`, or an argument that only `OptionsEnv` supports.
        ConfigError: an argument is invalid.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, num_envs: int = 1, config: Any = "paper-two-button", *, render_mode: str | None = None,
                 autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
                 output: Literal["numpy", "torch"] = "numpy", max_episode_steps: int | None = None,
                 **arguments: Any) -> None:
        super().__init__(num_envs, autoreset_mode, output, max_episode_steps)
        if render_mode is not None:
            raise UnsupportedError(f"render_mode = {render_mode!r}: the batched engine draws nothing; gymnasium.make "
                                   "makes a room that does")
        for name in _ELSEWHERE.keys() & arguments.keys():
            raise UnsupportedError(f"{name} = {arguments[name]!r}: in a batch {_ELSEWHERE[name]}; gymnasium.make makes "
                                   "a room that has it")
        self._arguments = {"num_envs": num_envs, "config": config, **arguments}
        self._batch = batch = BatchedOptionsEnv(**self._arguments, autoreset=False)
        self.render_mode = None
        self.single_observation_space, self.single_action_space = batch.observation_space, batch.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(gymnasium.spaces.Discrete(batch.actions), num_envs)
        self.action_names = batch.action_names
        if self._most_steps is not None and self._most_steps >= self._batch.room.tables.horizons.max():
            self._most_steps = None  # a decision takes a primitive or more, so the horizon comes first
        self._decisions = torch.zeros(num_envs, dtype=torch.int64, device=self.device)  # of the running episodes

    @property
    def device(self) -> torch.device:
        """Return the device of the rooms."""
        return self._batch.device

    def get_many_envs(self) -> BatchedOptionsEnv:
        """Make the same rooms, each deciding at its own pace, with automatic reset.

        Raises:
            UnsupportedError: there is a limit of decisions.
        """
        if self._most_steps is not None:
            raise UnsupportedError(f"max_episode_steps = {self._most_steps} counts decisions, and training in many "
                                   "rooms at once counts primitives: set the horizon of the rooms' `config` instead")
        arguments: dict[str, Any] = {**self._arguments, "instance": self._batch.rooms.instances}
        streams = BatchedOptionsEnv(**arguments)
        streams.set_option_discount(self._batch.gamma)
        return streams

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount per primitive, in [0, 1]."""
        self._batch.set_option_discount(gamma)

    def make_single_env(self) -> gymnasium.Env:
        """Make an `OptionsEnv` of the same rooms and options."""
        return self._limit(self._batch.make_single_env())

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values."""
        return self._batch.describe() | self._describe_own()

    def _count_steps(self) -> int:
        horizon = int(self._batch.room.tables.horizons.max())
        return horizon if self._most_steps is None else self._most_steps

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
              ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes, in all rooms or in the rooms of `options["reset_mask"]`, bool (num_envs,)."""
        self._check_open()
        where = self._read_mask(options)
        self._begin(self._make_seeds(seed), where)
        return self._give(self._batch.observation), self._inform(None, self._batch.action_mask, {})

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Run one decision in every room, or the reset that replaces it.

        Args:
            actions: whole numbers (num_envs,), as a numpy array, a list, or a tensor on the rooms' device.
        """
        self._check_open()
        batch = self._batch
        resets = batch.is_over if self.autoreset_mode == AutoresetMode.NEXT_STEP else torch.zeros_like(batch.is_over)
        if bool(resets.any()):
            self._begin(None, resets)
        done = self._decide(torch.where(resets, -1, self._take(actions)))
        over = done.terminated | done.truncated
        final: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and bool(over.any()):
            final = self._mark({"final_obs": self._give(batch.observation),
                                "final_info": self._inform(done, batch.action_mask, {})}, over)
            self._begin(None, over)
        return (self._give(batch.observation), self._give(done.reward), self._give(done.terminated),
                self._give(done.truncated), self._inform(done, batch.action_mask, final))

    def _begin(self, seeds: Tensor | None, where: Tensor | None) -> None:
        self._batch.reset(seeds, where)
        self._decisions = torch.zeros_like(self._decisions) if where is None else self._decisions.masked_fill(where, 0)

    def _cut(self, done: Transitions, idle: Tensor) -> Transitions:
        """Truncate the episodes that have reached the limit of decisions."""
        self._decisions = self._decisions + ~idle
        if self._most_steps is None:
            return done
        cut = (self._decisions >= self._most_steps) & ~idle
        room = self._batch.room
        room.state = room.state._replace(has_ended=torch.where(cut, 1, room.state.has_ended).to(
            room.state.has_ended.dtype))
        return done._replace(truncated=done.truncated | (cut & ~done.terminated))

    def _decide(self, action: Tensor) -> Transitions:
        """Run decisions until the last has ended; rooms with a negative action wait."""
        first = done = self._batch.step(action)
        left = (action >= 0) & ~first.where
        held = torch.full_like(action, -1)
        while bool(left.any()):
            found = self._batch.step(held)
            done = Transitions(*(torch.where(found.where.view(-1, *[1] * (new.dim() - 1)), new, old)
                                 for new, old in zip(found, done, strict=True)))
            left &= ~found.where
        idle = action < 0
        done = done._replace(reward=torch.where(idle, 0.0, done.reward),
                             terminated=done.terminated & ~idle, truncated=done.truncated & ~idle,
                             success=done.success & ~idle, duration=torch.where(idle, 0, done.duration))
        return self._cut(done, idle)

    # --- in and out --------------------------------------------------------------------

    def _inform(self, done: Transitions | None, mask: Tensor, more: dict[str, Any]) -> dict[str, Any]:
        if done is None:
            none = torch.zeros(self.num_envs, dtype=torch.int32, device=self.device)
            told = {"duration": none, "discount": none.float() + 1, "summed_reward": none.float(),
                    "discounted_reward": none.float(),
                    "ended": none.to(torch.int8) - 1, "primitives": self._batch.room.state.primitives,
                    "is_success": none.bool()}
            pressed = none.long()
        else:
            told, pressed = {name: getattr(done, name) for name in _TOLD}, done.pressed
            told |= {"summed_reward": done.reward, "is_success": done.success}
        told["pressed"] = unpack_bits(pressed, self._batch.room.layout.targets, torch.int8).T
        return self._mark({name: self._give(field) for name, field in ({"action_mask": mask} | told).items()}) | more

    def _take(self, actions: Any) -> Tensor:
        taken = super()._take(actions).to(torch.int64)
        if not isinstance(actions, Tensor) and (taken.shape != (self.num_envs,) or int(taken.min()) < 0):
            raise BatchError("action", np.asarray(actions), f"whole numbers of shape ({self.num_envs},)")
        return taken
