"""The flat Escape Room as a Gymnasium environment over the Bullet engine.

It shows one room instance to an agent: spaces, observations, rewards, rendering. The rules
are `kinematics.py`, the engine is `bullet_room.py`; temporally extended actions are added by
`hrl_escape.options`.
"""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from hrl_escape.env.bullet_cameras import check_camera, render_camera
from hrl_escape.env.bullet_room import BulletRoom
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Transition
from hrl_escape.env.observations import PIXELS, make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ActionError, ClosedError, ConfigError, ResetNeededError

__all__ = ["EscapeRoomEnv"]


class EscapeRoomEnv(gymnasium.Env[NDArray[Any], np.int64 | int], EzPickle):
    """A robot is locked in a room; it must solve a puzzle to open the exit.

    ## Description
    The Escape Room Domain of Menashe and Stone (2019). A wheeled base with an N-joint arm
    moves in small primitives through a room with walls, obstacles and wall buttons that
    depend on each other. Pressing a button counts only when its parents in a hidden graph
    are on. Once the puzzle is solved, standing in the exit ends the episode.

    ## Action space
    `Discrete(6 + 2 * joints)`:

    | action | primitive | effect |
    |---|---|---|
    | 0, 1 | forward, back | 1 m along the heading |
    | 2, 3 | strafe left, right | 1 m across the heading |
    | 4, 5 | turn left, right | 10 degrees |
    | 6 + 2i, 7 + 2i | joint i increment, decrement | 10 degrees |

    A move stops at first contact with 1 mm clearance and does not slide; a joint step that
    would pass a limit does nothing.

    ## Observation space
    Chosen by name: `state` (6 + N_p + N_j numbers, the paper's), `features` (the same in
    [-1, 1]), `egocentric` (ranges, bearings, lidar), `pixels` (84 x 84 RGB). The layouts are
    in `hrl_escape.env.observations`.

    ## Rewards
    -1 for every primitive, +100 more on the primitive that exits.

    ## Starting state
    One of the instance's start poses, chosen by the episode seed; all buttons off, arm at home.

    ## Episode end
    `terminated` when the body's axis is inside the exit and the puzzle is solved;
    `truncated` after `horizon` primitives (1,000).

    ## Information
    `info` has `instance` (content hash), `primitives` (so far), `buttons_on` (int8, one a
    target), `pressed` (indices of targets pressed by this primitive), `success`.

    ## Arguments
    Args:
        config: preset name, `RoomConfig`, or the dict form of one.
        instance: a `RoomInstance`, or the path of one saved as JSON, instead of `config`.
        instance_seed: which instance of the schematic (ignored with `instance`).
        observation: `state`, `features`, `egocentric` or `pixels`.
        render_mode: `rgb_array` or `human`.
        camera: `chase`, `overhead` or `robot`.
        render_size: width and height of frames in pixels.
        trail: draw the path of the episode into frames.
        resample_instance: draw a new instance at every reset from the episode's stream.

    `reset(options={"instance_seed": n})` moves to another instance of the schematic;
    `options={"state": state}` begins in a state given by `get_state`.

    ## Version history
    v0: first release.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 10}

    def __init__(
        self,
        config: str | RoomConfig | dict[str, Any] = "paper-two-button",
        *,
        instance: RoomInstance | str | Path | None = None,
        instance_seed: int = 0,
        observation: str = "state",
        render_mode: str | None = None,
        camera: str = "chase",
        render_size: tuple[int, int] = (640, 480),
        trail: bool = False,
        resample_instance: bool = False,
    ) -> None:
        EzPickle.__init__(
            self, config, instance=instance, instance_seed=instance_seed, observation=observation,
            render_mode=render_mode, camera=camera, render_size=render_size, trail=trail,
            resample_instance=resample_instance,
        )
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError("render_mode", render_mode, f"one of {self.metadata['render_modes']}, or None")
        check_camera(camera)
        self.render_mode = render_mode
        self.config: RoomConfig | None = None
        if instance is None:
            if isinstance(config, str):
                config = get_preset(config)
            self.config = config if isinstance(config, RoomConfig) else RoomConfig.from_dict(config)
            instance = generate(self.config, instance_seed)
        elif not isinstance(instance, RoomInstance):
            instance = RoomInstance.load(instance)
        if resample_instance and self.config is None:
            raise ConfigError("resample_instance", True, "false with a given instance: there is no schematic")
        self._kind, self._camera, self._size = observation, camera, render_size
        self._resample, self._trailing = resample_instance, trail
        self._trail: list[tuple[float, float]] = []
        self._state: RoomState | None = None
        self._ended = False
        self.room: BulletRoom | None = None
        self._enter(instance)

    def _enter(self, instance: RoomInstance) -> None:
        """Build the engine, spaces and tables of an instance."""
        if self.room is not None:
            self.room.close()
        self.instance = instance
        self.room = BulletRoom(instance, gui=self.render_mode == "human")
        self.rules = self.room.rules
        self._observer = make_observer(self._kind, self.rules)
        if self._observer is None:
            self.observation_space = spaces.Box(0, 255, (*PIXELS, 3), dtype=np.uint8)
        else:
            self.observation_space = spaces.Box(self._observer.low, self._observer.high, dtype=np.float32)
        self._count = len(self.rules.primitives)
        self.action_space = spaces.Discrete(self._count)
        self._lit: dict[Any, NDArray[np.int8]] = {}

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode; see the class for `options`."""
        super().reset(seed=seed)
        options = dict(options or {})
        room = self._get_room()
        instance_seed, state = options.pop("instance_seed", None), options.pop("state", None)
        if options:
            raise ConfigError("reset options", sorted(options), "instance_seed, state")
        if self._resample and instance_seed is None:
            instance_seed = int(self.np_random.integers(2**31))
        if instance_seed is not None:
            if self.config is None:
                raise ConfigError("reset options.instance_seed", instance_seed, "nothing: there is no schematic")
            self._enter(generate(self.config, instance_seed))
            room = self._get_room()
        start = self.instance.starts[int(self.np_random.integers(len(self.instance.starts)))]
        noise_key = int(self.np_random.integers(2**63))
        self._state = room.reset(start, noise_key)
        self._ended = False
        self._trail = [(self._state.x, self._state.y)]
        if state is not None:
            self.set_state(state)
        return self._observe(), self._inform((), False)

    def step(self, action: np.int64 | int) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Run one primitive."""
        if self._state is None or self._ended:
            self._get_room()
            raise ResetNeededError("call reset() first: " + ("the episode has ended" if self._ended
                                                            else "no episode has begun"))
        try:
            number = operator.index(action)
        except TypeError:
            raise ActionError(action, self._count) from None
        if not 0 <= number < self._count:
            raise ActionError(action, self._count)
        transition: Transition = self.room.step(number)  # type: ignore[union-attr]  # a state means a room
        self._state, reward, terminated, truncated, pressed = transition
        self._ended = terminated or truncated
        if self._trailing:
            self._trail.append((self._state.x, self._state.y))
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, terminated, truncated, self._inform(pressed, terminated)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return a frame (height, width, 3), uint8, or keep Bullet's window in step."""
        room = self._get_room()
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' at construction")
            return None
        if self.render_mode == "human":
            room.show(self.metadata["render_fps"])
            return None
        return render_camera(room, self._camera, *self._size, trail=self._trail if self._trailing else ())

    def close(self) -> None:
        """Free the engine; safe to call twice."""
        if self.room is not None:
            self.room.close()
            self.room = None
            self._state = None

    # --- state -------------------------------------------------------------------------

    def get_state(self) -> RoomState:
        """Return the full state; `set_state` continues from it exactly."""
        self._get_room()
        if self._state is None:
            raise ResetNeededError("call reset() first: no episode has begun")
        return self._state

    def set_state(self, state: RoomState) -> None:
        """Continue from a state, as if the episode had come to it; noise included."""
        self._get_room().set_state(state)
        self._state, self._ended = state, False

    def _get_room(self) -> BulletRoom:
        if self.room is None:
            raise ClosedError("the environment was closed; make a new one")
        return self.room

    def _observe(self) -> NDArray[Any]:
        if self._observer is None:
            return render_camera(self._get_room(), "robot", *PIXELS)
        return self._observer.observe(self._state)  # type: ignore[arg-type]  # called within an episode

    def _inform(self, pressed: tuple[int, ...], success: bool) -> dict[str, Any]:
        state: RoomState = self._state  # type: ignore[assignment]  # called within an episode
        lit = self._lit.get(state.puzzle)
        if lit is None:
            lit = np.array(self.instance.puzzle.get_lit(state.puzzle), dtype=np.int8)
            if len(self._lit) < 4096:
                self._lit[state.puzzle] = lit
        return {"instance": self.instance.id, "primitives": state.primitives, "buttons_on": lit.copy(),
                "pressed": pressed, "success": success}
