"""Thousands of rooms with options as one Gymnasium `VectorEnv`: a step is one decision of every room.

`gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=1024)` makes one. A room whose decision has ended
stands still until the last one's has; `get_streams` gives the same rooms, each at its own pace, as `train` uses them.
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

from hrl_escape.env.batched.engine import draw_seed
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
    """Many rooms in which every step takes one decision of each; see `OptionsEnv` for the task and the actions.

    `infos` holds arrays over rooms: `action_mask` (bool), `duration`, `discount` and `discounted_reward` as
    `OptionsEnv` gives them, as `pressed`, `ended` (an index into `ENDINGS`), `primitives` (of the episode so far) and
    `is_success`; at a reset those of a decision in which nothing ran. The three kinds of automatic reset are those of
    `EscapeRoomVectorEnv`.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        render_mode: must be None.
        autoreset_mode: `NextStep`, `SameStep` or `Disabled`.
        output: `numpy` arrays, or `torch` tensors on the device.
        arguments: all other arguments of `BatchedOptionsEnv`.

    Raises:
        UnsupportedError: `render_mode`, or an argument that only `OptionsEnv` has.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, num_envs: int = 1, config: Any = "paper-two-button", *, render_mode: str | None = None,
                 autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
                 output: Literal["numpy", "torch"] = "numpy", **arguments: Any) -> None:
        super().__init__(num_envs, autoreset_mode, output)
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

    @property
    def device(self) -> torch.device:
        """Device of the rooms."""
        return self._batch.device

    def get_streams(self) -> BatchedOptionsEnv:
        """Make the same rooms, each deciding at its own pace, with automatic reset."""
        arguments: dict[str, Any] = {**self._arguments, "instance": self._batch.rooms.instances}
        return BatchedOptionsEnv(**arguments)

    def make_single_env(self) -> gymnasium.Env:
        """Make an `OptionsEnv` of the same rooms and options."""
        return self._batch.make_single_env()

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values."""
        return self._batch.describe() | {"autoreset_mode": self.autoreset_mode.value}

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
              ) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes, in all rooms or in those of `options["reset_mask"]`, bool (num_envs,)."""
        self._check_open()
        where = self._read_mask(options)
        seeds: Tensor | int | None = None
        if seed is not None and not isinstance(seed, (int, np.integer)):
            seeds = torch.tensor(list(seed), dtype=torch.int64, device=self.device)
        elif seed is not None or not self._is_seeded:
            seeds = draw_seed() if seed is None else int(seed)
        self._batch.reset(seeds, where)
        self._is_seeded = True
        return self._give(self._batch.observation), self._inform(None, self._batch.action_mask, {})

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Run one decision in every room, or the reset that takes its place.

        Args:
            actions: whole numbers (num_envs,), a numpy array, a list, or a tensor on the rooms' device.
        """
        self._check_open()
        batch = self._batch
        resets = batch.is_over if self.autoreset_mode == AutoresetMode.NEXT_STEP else torch.zeros_like(batch.is_over)
        if bool(resets.any()):
            batch.reset(where=resets)
        done = self._decide(torch.where(resets, -1, self._take(actions)))
        over = done.terminated | done.truncated
        final: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and bool(over.any()):
            which = self._give(over)
            final = {"final_obs": self._give(batch.observation), "_final_obs": which,
                     "final_info": self._inform(done, batch.action_mask, {}), "_final_info": which}
            batch.reset(where=over)
        return (self._give(batch.observation), self._give(done.reward), self._give(done.terminated),
                self._give(done.truncated), self._inform(done, batch.action_mask, final))

    def _decide(self, action: Tensor) -> Transitions:
        """Run decisions until the last has ended; rooms with a negative action stand still."""
        first = done = self._batch.step(action)
        left = (action >= 0) & ~first.where
        held = torch.full_like(action, -1)
        while bool(left.any()):
            found = self._batch.step(held)
            done = Transitions(*(torch.where(found.where.view(-1, *[1] * (new.dim() - 1)), new, old)
                                 for new, old in zip(found, done, strict=True)))
            left &= ~found.where
        idle = action < 0
        return done._replace(reward=torch.where(idle, 0.0, done.reward),
                             terminated=done.terminated & ~idle, truncated=done.truncated & ~idle,
                             success=done.success & ~idle, duration=torch.where(idle, 0, done.duration))

    # --- in and out --------------------------------------------------------------------

    def _inform(self, done: Transitions | None, mask: Tensor, more: dict[str, Any]) -> dict[str, Any]:
        if done is None:
            none = torch.zeros(self.num_envs, dtype=torch.int32, device=self.device)
            told = {"duration": none, "discount": none.float() + 1, "discounted_reward": none.float(),
                    "ended": none.to(torch.int8) - 1, "primitives": self._batch.room.state.primitives,
                    "is_success": none.bool()}
            pressed = none.long()
        else:
            told, pressed = {name: getattr(done, name) for name in _TOLD} | {"is_success": done.success}, done.pressed
        told["pressed"] = unpack_bits(pressed, self._batch.room.layout.targets, torch.int8).T
        infos = {name: self._give(field) for name, field in ({"action_mask": mask} | told).items()}
        every = self._give(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
        return infos | {f"_{name}": every for name in infos} | more

    def _take(self, actions: Any) -> Tensor:
        taken = super()._take(actions).to(torch.int64)
        if not isinstance(actions, Tensor) and (taken.shape != (self.num_envs,) or int(taken.min()) < 0):
            raise BatchError("action", np.asarray(actions), f"whole numbers of shape ({self.num_envs},)")
        return taken
