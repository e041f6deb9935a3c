"""Thousands of Escape Rooms as one Gymnasium `VectorEnv` over the batched engine.

`gymnasium.make_vec("hrl_escape/PaperTwoButton-v1", num_envs=4096)` makes one. Spaces, observations, rewards and rules
equal those in `escape_room.py`. The observation `pixels` and rigid-body physics require the Bullet engine. The batch
renders pictures with its own cameras.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor
from typing_extensions import Unpack

from hrl_escape.env.batched.cameras import BatchedCamera, Pictures
from hrl_escape.env.batched.engine import Autoreset, RoomInfo, TensorRoom, draw_seed, make_room_keys
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.rooms import RoomArguments, Rooms
from hrl_escape.env.batched.tables import INSTEAD
from hrl_escape.env.noise import check_seed
from hrl_escape.env.presets import ConfigForm
from hrl_escape.errors import BatchError, ClosedError, ConfigError, UnsupportedError
from hrl_escape.spaces import bound_episodes, make_vector_space

_AUTORESETS: dict[AutoresetMode, Autoreset] = {
    AutoresetMode.NEXT_STEP: "next-step",
    AutoresetMode.SAME_STEP: "same-step",
    AutoresetMode.DISABLED: "disabled",
}


class BatchVectorEnv(VectorEnv):
    """Base class of vector environments over the batched engine: reset modes, and numpy or torch output."""

    metadata: dict[str, Any] = {}
    autoreset_mode: AutoresetMode
    _spec: EnvSpec | None = None

    def __init__(self, num_envs: int, autoreset_mode: str | AutoresetMode, output: str,
                 max_episode_steps: int | None) -> None:
        super().__init__()
        if isinstance(max_episode_steps, bool) or not isinstance(max_episode_steps, int | np.integer | None) \
                or (max_episode_steps is not None and max_episode_steps != -1 and max_episode_steps < 1):
            raise ConfigError("max_episode_steps", max_episode_steps, "at least 1, or None for the room's horizon")
        self._most_steps = None if max_episode_steps is None or max_episode_steps < 0 else int(max_episode_steps)
        if output not in ("numpy", "torch"):
            raise ConfigError("output", output, "'numpy' or 'torch'")
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            allowed = "one of " + ", ".join(repr(m.value) for m in AutoresetMode)
            raise ConfigError("autoreset_mode", autoreset_mode, allowed) from None
        self.num_envs, self.metadata = num_envs, type(self).metadata | {"autoreset_mode": self.autoreset_mode}
        self._is_numpy, self._is_seeded = output == "numpy", False

    @property
    @abstractmethod
    def device(self) -> torch.device:
        """Device of the rooms."""

    @abstractmethod
    def _count_steps(self) -> int:
        """Largest number of steps in an episode, which is then truncated."""

    @property
    def spec(self) -> EnvSpec | None:
        """Specification that `gymnasium.make_vec` used; episodes are truncated after its `max_episode_steps`."""
        return self._spec

    @spec.setter
    def spec(  # pyright: ignore[reportIncompatibleVariableOverride]  # a plain attribute there
            self, spec: EnvSpec | None) -> None:
        self._spec = made = bound_episodes(spec, self._count_steps())
        if made is not None:  # `make_vec` writes the registered limit into the specification
            made.kwargs = {**made.kwargs, "max_episode_steps": made.max_episode_steps}

    def _mark(self, infos: dict[str, Any], which: Tensor | None = None) -> dict[str, Any]:
        """Add Gymnasium's mask `_key` of each key: a copy of `which`, bool (num_envs,), or all true."""
        shape = len(infos), self.num_envs
        rows = torch.ones(shape, dtype=torch.bool, device=self.device) if which is None else which.repeat(shape[0], 1)
        return infos | {f"_{name}": row for name, row in zip(infos, self._give(rows), strict=True)}

    def _make_seeds(self, seed: int | Sequence[int | None] | None) -> Tensor | None:
        """Random keys of all rooms, int64 (num_envs,), from one seed or one per room, or None to keep the streams."""
        if seed is None and self._is_seeded:
            return None
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
            first = draw_seed() if seed is None else check_seed(seed)
            super().reset(seed=first)
            seeds = list(range(first, first + self.num_envs))
        else:
            seeds = [draw_seed() if one is None else check_seed(one) for one in seed]
        if len(seeds) != self.num_envs:
            raise ConfigError("seed", seed, f"a whole number of at least 0, or {self.num_envs} of them")
        self._is_seeded = True
        return make_room_keys(seeds, self.device)

    def _limit(self, env: gymnasium.Env) -> gymnasium.Env:
        return env if self._most_steps is None else gymnasium.wrappers.TimeLimit(env, self._most_steps)

    def _describe_own(self) -> dict[str, Any]:
        limit = {} if self._most_steps is None else {"max_episode_steps": self._most_steps}
        return {"autoreset_mode": self.autoreset_mode.value, **limit}

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed. Make a new one")

    def _read_mask(self, options: dict[str, Any] | None) -> Tensor | None:
        """Rooms to reset, bool (num_envs,), from the options of `reset`, or None for all rooms."""
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise ConfigError("reset options", sorted(options), "reset_mask")
        where = None if mask is None else torch.as_tensor(mask, device=self.device)
        if where is not None and where.dtype == torch.bool and not where.any():
            raise ConfigError("reset_mask", "(all false)", "true for at least one room")
        return where

    def _take(self, actions: Any) -> Tensor:
        """Actions on the device, int64 or float64. Tensors are passed through; the engine checks them."""
        if isinstance(actions, Tensor):
            return actions
        array, is_whole = np.asarray(actions), self.action_space.dtype == np.int64
        if array.dtype.kind not in ("iu" if is_whole else "iuf"):
            numbers = "whole numbers" if is_whole else "numbers"
            raise BatchError("action", array, f"{numbers} of shape {self.action_space.shape}")
        return torch.from_numpy(array.astype(np.int64 if is_whole else np.float64, copy=False)).to(self.device)

    def _give(self, tensor: Tensor | None) -> Any:
        return tensor if tensor is None or not self._is_numpy else tensor.cpu().numpy()


class EscapeRoomVectorEnv(BatchVectorEnv):
    """Many rooms that step together. `EscapeRoomEnv` describes the task.

    ## Spaces
    The actions and the vector observations of `EscapeRoomEnv`, batched over `num_envs`.

    ## Automatic reset
    All three modes of Gymnasium. `NextStep`: the step after the end of an episode ignores its action, begins the next
    episode and has reward 0. `SameStep`: the next episode begins in the same step; `infos` holds `final_obs` and
    `final_info` of the rooms marked in `_final_obs`. `Disabled`: `reset(options={"reset_mask": mask})` resets the rooms
    in the mask.

    ## Information
    Arrays over rooms, as in `SyncVectorEnv`: `primitives` (so far, int32), `is_success` (bool), `pressed` and
    `buttons_on` (int8, one per target) and `instance`: the index of each room in `instances`, or the content hash if
    there is only one. With `output="torch"`, `instance_index` (the index) replaces `instance`.

    ## Pictures
    `take_pictures(camera, width, height)` returns colours, depth and labels from the camera of each room, as tensors on
    the device. With `render_mode="rgb_array"`, `render()` returns the colours as a tuple of frames, one per room.

    ## Random numbers
    `reset(seed=n)` seeds room i with n + i. The outcome in a room depends on its own seed and actions only, and is the
    same in a batch of any size.

    ## Arguments
    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        observation: name of a vector observation.
        render_mode: `rgb_array`, or None.
        camera: `robot` or `overhead`.
        render_size: width and height of frames in pixels.
        autoreset_mode: `NextStep`, `SameStep` or `Disabled`.
        output: `numpy` arrays, or `torch` tensors on the device, which cost no copy.
        max_episode_steps: largest number of steps in an episode, if smaller than the room's horizon.
        rooms: `instance`, `instance_seed`, `num_instances`, `resample_instance`, `device` and `compile`; see `Rooms`.

    ## Version history
    v1: the numbers of buttons do not reveal their order (`graph.relabel`). v0: first release.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}
    velocities: Any = None  # `Velocities` in environments with continuous actions

    def __init__(
        self,
        num_envs: int = 1,
        config: ConfigForm = "paper-two-button",
        *,
        observation: str = "state",
        render_mode: str | None = None,
        camera: str = "overhead",
        render_size: tuple[int, int] = (160, 120),
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        output: Literal["numpy", "torch"] = "numpy",
        max_episode_steps: int | None = None,
        **rooms: Unpack[RoomArguments],
    ) -> None:
        super().__init__(num_envs, autoreset_mode, output, max_episode_steps)
        if render_mode not in (None, *type(self).metadata["render_modes"]):
            raise UnsupportedError(f"render_mode = {render_mode!r}: the batched engine opens no window; {INSTEAD}")
        if not isinstance(render_size, (tuple, list)) or len(render_size) != 2:
            raise ConfigError("render_size", render_size, "a pair of width and height")
        self.rooms = Rooms(num_envs, config, observation=observation, **rooms)
        self.room = TensorRoom(self.rooms, autoreset=_AUTORESETS[self.autoreset_mode], velocities=self.velocities,
                               most_steps=self._most_steps)
        self.instances = self.room.instances
        self.render_mode = render_mode
        self._cameras: dict[tuple[str, int, int], BatchedCamera] = {}
        self._view = (camera, *render_size)
        if render_mode is not None:
            self._get_camera(*self._view)
        room = self.room
        self.single_observation_space = make_vector_space(room.low, room.high, room.rows, room.words)
        self.single_action_space = self._make_action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ids = np.array([one.id for one in self.instances], dtype=object)

    def _make_action_space(self) -> spaces.Space:
        return spaces.Discrete(self.room.actions)

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: room i gets seed + i, or its own from a list; by default the streams continue.
            options: `reset_mask`, bool (num_envs,): reset only these rooms.
        """
        self._check_open()
        where = self._read_mask(options)
        observation = self.room.reset(self._make_seeds(seed), where)
        return self._give(observation), self._make_infos(self.room.inform())

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Run one primitive in every room: integers (num_envs,) as a list, an array, or a tensor on the device."""
        self._check_open()
        seen, reward, terminated, truncated, info, final_seen, final_info = self.room.step(self._take(actions))
        infos = self._make_infos(info)
        if final_info is not None and bool((ended := terminated | truncated).any()):
            final = {"final_obs": self._give(final_seen), "final_info": self._make_infos(final_info, ended)}
            infos |= self._mark(final, ended)
        return self._give(seen), self._give(reward), self._give(terminated), self._give(truncated), infos

    def take_pictures(self, camera: str = "robot", width: int = 84, height: int = 84) -> Pictures:
        """Take a picture of every room in its current state, on the device of the rooms.

        Args:
            camera: `robot`, the view ahead from the front of the robot, or `overhead`.
            width: pixels, from 8 to 2048.
            height: pixels, from 8 to 2048.

        Raises:
            UnknownNameError: no camera of that name.
            ConfigError: an impossible size.
            UnsupportedError: the camera `chase`, a robot with an arm, or targets with cues.
            ResetNeededError: no episode has begun.
        """
        self._check_open()
        return self._get_camera(camera, width, height).take()

    def render(self) -> tuple[Any, ...] | None:
        """Take the frames of all rooms, uint8 (height, width, 3) each, or None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return tuple(self.take_pictures(*self._view).rgb.cpu().numpy())

    def _get_camera(self, camera: str, width: int, height: int) -> BatchedCamera:
        key = (camera, width, height)
        if key not in self._cameras:
            self._cameras[key] = BatchedCamera(self.room, *key)
        return self._cameras[key]

    def close_extras(self, **kwargs: Any) -> None:
        """Drop the room and its cameras, which frees their tensors."""
        self._cameras.clear()
        del self.room

    @property
    def device(self) -> torch.device:
        """Device of the rooms."""
        return self.room.device

    def _count_steps(self) -> int:
        return int(self.room.tables.horizons.max())

    def make_single_env(self) -> gymnasium.Env:
        """Make an `EscapeRoomEnv` with the same rooms and observation."""
        from hrl_escape.env.escape_room import EscapeRoomEnv  # brings Bullet in

        return self._limit(EscapeRoomEnv(**self.rooms.list_single_arguments()))

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values; rooms go by their ids."""
        return self.rooms.describe() | self._describe_own()

    def state_dict(self) -> dict[str, Any]:
        """Return the running episodes of all rooms, as arrays."""
        return {name: field.cpu().numpy() for name, field in self.room.state._asdict().items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore `state_dict` of an environment with the same rooms, as many of them."""
        self.room.state = TensorState(**{name: torch.from_numpy(np.asarray(field)).to(self.device)
                                         for name, field in state.items()})
        self._is_seeded = True

    # --- in and out --------------------------------------------------------------------

    def _make_infos(self, info: RoomInfo, which: Tensor | None = None) -> dict[str, Any]:
        """Information of some rooms (all by default), with Gymnasium's masks."""
        values = {**self._tell_time(info), "is_success": info.success != 0, "pressed": info.pressed,
                  "buttons_on": info.buttons_on, "instance_index": info.instance}
        infos: dict[str, Any] = {name: self._give(value) for name, value in values.items()}
        if self._is_numpy:
            index = infos.pop("instance_index")
            infos["instance"] = index if len(self.instances) > 1 else self._ids[index]
            for array in infos.values():
                array.setflags(write=False)  # it may share memory with the rooms
        return self._mark(infos, which)

    def _tell_time(self, info: RoomInfo) -> dict[str, Tensor]:
        """Time that the episodes have taken so far."""
        return {"primitives": info.primitives}
