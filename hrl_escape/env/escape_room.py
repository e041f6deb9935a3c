"""The flat Escape Room as a Gymnasium environment over one engine.

It presents one room instance to an agent: spaces, observations, rewards and rendering. `kinematics.py` holds the rules
and `engine.py` the engines. `hrl_escape.options` adds temporally extended actions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.engine import Engine, Renderer, check_camera, check_picture_size, make_engine, make_renderer
from hrl_escape.env.instance import InstanceForm, RoomInstance, read_instance
from hrl_escape.env.kinematics import QUIET, RoomState
from hrl_escape.env.noise import check_seed, draw_episode, fold_seed
from hrl_escape.env.observations.base import Observer, make_observer
from hrl_escape.env.poses import list_touched
from hrl_escape.env.presets import ConfigForm, read_config
from hrl_escape.env.rewards import Events
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ClosedError, ConfigError, ResetNeededError
from hrl_escape.spaces import bound_episodes, keep_space, make_vector_space
from hrl_escape.step_info import read_action

_EPISODE = ("_state", "_ended", "events", "_trail", "_stream", "_episode", "_np_random", "_np_random_seed",
            "action_space", "observation_space")
"""Attributes that a copy of an environment keeps."""


class EscapeRoomEnv(gymnasium.Env[NDArray[Any], np.int64 | int], EzPickle):
    """A robot is locked in a room and must solve a puzzle to open the exit.

    ## Description
    The Escape Room Domain of Menashe and Stone (2019). A wheeled base with an N-joint arm moves in small primitives
    through a room with walls, obstacles and wall buttons. Buttons depend on each other: a press counts only if the
    parents of the button in a hidden graph are on. Once the puzzle is solved, reaching the exit ends the episode.

    ## Action space
    `Discrete`, one action for each primitive of the robot's `ActionTable`:

    | action | primitive | effect |
    |---|---|---|
    | 0, 1 | forward, back | 1 m along the heading |
    | 2, 3 | strafe left, right | 1 m across the heading |
    | 4, 5 | turn left, right | 10 degrees |
    | then | for each joint: increment, decrement | 10 degrees |

    A robot with `robot.drive = "differential"` has no strafes, and all later numbers are smaller by two.

    A move stops at the first contact, 1 mm before it, and does not slide. A joint step that would exceed a limit has no
    effect.

    ## Observation space
    Chosen by name from the registry in `hrl_escape.env.observations`: `state` (the vector of the
    paper), `features` (the same in [-1, 1]), `egocentric` (ranges, bearings, lidar), `pixels` (84 x 84 RGB), or a
    registered one of your own.

    ## Rewards
    -1 for every primitive, and +100 for the primitive that reaches the exit. Some puzzles add rewards.

    ## Starting state
    One of the instance's start poses and one of the puzzle's initial states, chosen by the episode seed. The arm is at
    home.

    ## Episode end
    `terminated` when the body's axis is inside the exit and the puzzle is solved (`is_success`), or when a puzzle that
    can fail has failed. `truncated` after `horizon` primitives (1,000).

    ## Information
    `info` has `instance` (content hash), `primitives` (so far), `is_success`, and int8 arrays with one entry per
    target: `buttons_on` (1 if it is on) and `pressed` (1 if the latest primitive pressed it).

    ## Arguments
    Args:
        config: preset name, `RoomConfig`, or the dict form of one.
        instance: a `RoomInstance`, its dict form, or the path of a saved one, instead of `config`.
        instance_seed: seed of the instance sampled from `config`; ignored with `instance`.
        instances: a sequence of rooms of one room configuration, instead of `config`. The environment starts in the
            first; each reset draws one from the random stream of episodes. The sequence can generate rooms lazily.
        observation: name of a registered observation.
        render_mode: `rgb_array` or `human`.
        camera: `chase`, `overhead` or `robot`.
        render_size: width and height of frames in pixels.
        trail: draw the path of the episode into frames.
        resample_instance: sample a new instance at every reset from the random stream of episodes.
        engine: name of a registered engine.

    `reset(options=...)` accepts `{"instance_seed": n}` for another instance of the room configuration,
    `{"instance_index": i}` for a room of `instances`, and `{"state": state}` to start in a state from `get_state`.

    The attribute `events` holds the `Events` of the latest primitive.

    ## Version history
    v1: the numbers of buttons do not reveal their order (`graph.relabel`). v0: first release.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 10}
    _spec: EnvSpec | None = None

    def __init__(
        self,
        config: ConfigForm = "paper-two-button",
        *,
        instance: InstanceForm | None = None,
        instance_seed: int = 0,
        instances: Sequence[InstanceForm] | None = None,
        observation: str = "state",
        render_mode: str | None = None,
        camera: str = "chase",
        render_size: tuple[int, int] = (640, 480),
        trail: bool = False,
        resample_instance: bool = False,
        engine: str = "bullet",
    ) -> None:
        EzPickle.__init__(self, config, instance=instance, instance_seed=instance_seed, instances=instances,
                          observation=observation, render_mode=render_mode, camera=camera, render_size=render_size,
                          trail=trail, resample_instance=resample_instance, engine=engine)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError("render_mode", render_mode, f"one of {self.metadata['render_modes']}, or None")
        check_camera(camera)
        if not isinstance(render_size, (tuple, list)) or len(render_size) != 2:
            raise ConfigError("render_size", render_size, "a pair of width and height")
        check_picture_size(*render_size)
        self.render_mode = render_mode
        self.config: RoomConfig | None = None
        self._instances = instances
        if instances is not None:
            if instance is not None or not len(instances):
                raise ConfigError("instances", instances, "at least one room, and no argument instance")
            instance = read_instance(instances[0])
        elif instance is None:
            self.config = read_config(config)
            instance = generate(self.config, instance_seed)
        else:
            instance = read_instance(instance)
        if resample_instance and self.config is None:
            raise ConfigError("resample_instance", True, "false with a given instance; pass config to sample rooms")
        self._kind, self._camera, self._size, self._engine = observation, camera, render_size, engine
        self._resample, self._trailing = resample_instance, trail
        self._trail: list[tuple[float, float]] = []
        self._state: RoomState | None = None
        self._ended, self.events = False, QUIET
        self._stream, self._episode = -1, 0
        self.instance_index = None if instances is None else 0
        self.room: Engine | None = None
        self._renderer: Renderer | None = None
        self._enter(instance)

    def _enter(self, instance: RoomInstance) -> None:
        if self.room is not None:
            self.room.close()
        self.instance = instance
        self.room = make_engine(instance, self._engine, window=self.render_mode == "human")
        self._renderer = make_renderer(instance, self._engine)
        self.rules = self.room.rules
        self._observer = make_observer(self._kind, self.rules, self._renderer)
        low, high = self._observer.low, self._observer.high
        seen = make_vector_space(low, high, self._observer.rows, self._observer.words)
        self.observation_space = keep_space(seen, getattr(self, "observation_space", None))
        self._count = len(self.rules.actions)
        self.action_space = keep_space(self._make_action_space(), getattr(self, "action_space", None))
        self._lit: dict[Any, NDArray[np.int8]] = {}

    def _make_action_space(self) -> spaces.Space[Any]:
        return spaces.Discrete(self._count)

    def _enter_index(self, index: Any) -> None:
        count = 0 if self._instances is None else len(self._instances)
        if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or not 0 <= index < count:
            raise ConfigError("reset options.instance_index", index, f"an index of one of {count} instances")
        self.instance_index = int(index)
        instance = read_instance(self._instances[self.instance_index])  # type: ignore[index]  # checked above
        if instance.id != self.instance.id:
            self._enter(instance)

    @property
    def observer(self) -> Observer:
        """Observer of the current room."""
        return self._observer

    def describe(self) -> dict[str, Any]:
        """Return the arguments that affect dynamics, rewards and observations, as JSON values.

        Arguments of drawing are omitted. The instance is given as its content hash `id` and its `content`.
        """
        if self._resample and self.config is not None:
            return {"config": self.config.to_dict(), "observation": self._kind, "engine": self._engine,
                    "resample_instance": True}
        if self._instances is not None:
            rooms = [read_instance(room) for room in self._instances]
            every = {"id": hashlib.sha256("".join(room.digest for room in rooms).encode()).hexdigest()[:16],
                     "content": [room.to_dict() for room in rooms]}
            return {"instances": every, "observation": self._kind, "engine": self._engine}
        instance = {"id": self.instance.id, "content": self.instance.to_dict()}
        return {"instance": instance, "observation": self._kind, "engine": self._engine}

    # --- Gymnasium ---------------------------------------------------------------------

    @property
    def spec(self) -> EnvSpec | None:
        """Specification that `gymnasium.make` used; its `max_episode_steps` is the horizon of the room."""
        return self._spec

    @spec.setter
    def spec(  # pyright: ignore[reportIncompatibleVariableOverride]  # a plain attribute there
            self, spec: EnvSpec | None) -> None:
        self._spec = bound_episodes(spec, self._count_steps())

    def _count_steps(self) -> int:
        """Largest number of steps in an episode, which is then truncated."""
        return self.instance.horizon

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode and return the observation and `info`; the class describes `options`."""
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        if not isinstance(options, Mapping | None):
            raise ConfigError("reset options", options, "a table of instance_seed, instance_index and state, or None")
        options = dict(options or {})
        self._get_room()
        instance_seed, state = options.pop("instance_seed", None), options.pop("state", None)
        index = options.pop("instance_index", None)
        if options:
            raise ConfigError("reset options", sorted(options), "instance_seed, instance_index, state")
        if self._instances is not None and index is None:
            index = int(self.np_random.integers(len(self._instances)))
        if index is not None:
            self._enter_index(index)
        if self._resample and instance_seed is None:
            instance_seed = int(self.np_random.integers(2**31))
        if instance_seed is not None:
            if self.config is None:
                raise ConfigError("reset options.instance_seed", instance_seed,
                                  "left out if the environment was made from rooms instead of a configuration")
            self._enter(generate(self.config, instance_seed))
        self._begin_stream(seed)
        number, noise_key = draw_episode(self._stream, self._episode, len(self.instance.starts))
        self._state = self._get_room().reset(self.instance.starts[number], noise_key)
        self._ended, self.events = False, QUIET
        self._trail = [(self._state.x, self._state.y)]
        if state is not None:
            self.set_state(state)
        return self._observe(), self._inform(QUIET)

    def _begin_stream(self, seed: int | None) -> None:
        """Count the episode. A seed begins a new stream of starts and noise, as in a batch of rooms."""
        if seed is not None or self._stream < 0:
            self._stream = int(self.np_random.integers(2**63)) if seed is None else fold_seed(seed)
            self._episode = 0
        else:
            self._episode += 1

    def step(self, action: np.int64 | int) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Run one primitive, an index of the action table, and return Gymnasium's five values."""
        _, room = self._require_episode()
        return self._finish(*room.step(read_action(action, self._count)))

    def _require_episode(self) -> tuple[RoomState, Engine]:
        room, state = self.room or self._get_room(), self._state
        if state is None or self._ended:
            raise ResetNeededError("call reset() first: " + ("the episode has ended" if self._ended
                                                            else "no episode has begun"))
        return state, room

    def _finish(self, state: RoomState, reward: float, terminated: bool, truncated: bool, events: Events
                ) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Store the outcome of a step and return Gymnasium's five values."""
        self._state, self.events = state, events
        self._ended = terminated or truncated
        if self._trailing:
            self._trail.append((state.x, state.y))
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, terminated, truncated, self._inform(events)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]  # Gymnasium's frames are generic
        """Return a frame (height, width, 3), uint8, or update Bullet's window in `human` mode."""
        room = self._get_room()
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' at construction")
            return None
        if self.render_mode == "human":
            room.show(self.metadata["render_fps"])
            return None
        trail = self._trail if self._trailing else ()
        return self._renderer.render(room.state, self._camera, *self._size, trail=trail)  # type: ignore[union-attr]  # set

    def close(self) -> None:
        """Free the engine. Further calls have no effect."""
        if self.room is not None:
            self.room.close()
            self.room = self._renderer = None
            self._state = None

    # --- copies ------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        """Return arguments and running episode for pickles and deep copies; renderers and windows are rebuilt."""
        episode = {name: getattr(self, name) for name in _EPISODE}
        return EzPickle.__getstate__(self) | {"instance": self.instance, "is_closed": self.room is None,
                                              "episode": episode}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Rebuild the environment and continue the copied episode."""
        EzPickle.__setstate__(self, state)
        if state["instance"] != self.instance:
            self._enter(state["instance"])
        self.__dict__.update(state["episode"])
        if self._state is not None:
            self._get_room().set_state(self._state)
        if state["is_closed"]:
            self.close()

    # --- state -------------------------------------------------------------------------

    def get_state(self) -> RoomState:
        """Return the full state; `set_state` continues from it exactly."""
        self._get_room()
        if self._state is None:
            raise ResetNeededError("call reset() first: no episode has begun")
        return self._state

    def set_state(self, state: RoomState) -> None:
        """Continue from a state; the noise that follows is the same as after that state."""
        self._get_room().set_state(state)
        self._state, self._ended, self.events = state, False, QUIET

    def _get_room(self) -> Engine:
        if self.room is None:
            raise ClosedError("the environment is closed. Make a new one")
        return self.room

    def _observe(self) -> NDArray[Any]:
        return self._observer.observe(self._state)  # type: ignore[arg-type]  # set during an episode

    def _inform(self, events: Events) -> dict[str, Any]:
        state: RoomState = self._state  # type: ignore[assignment]  # set during an episode
        lit = self._lit.get(state.puzzle)
        if lit is None:
            lit = np.zeros(len(self.instance.frame.target_names), dtype=np.int8)
            lit[: len(self.instance.targets)] = self.instance.puzzle.get_lit(state.puzzle)
            if len(self._lit) < 4096:
                self._lit[state.puzzle] = lit
        begun = np.zeros(len(lit), dtype=np.int8)
        if events.pressed:
            begun[list(list_touched(events.pressed))] = 1
        return {"instance": self.instance.id, "primitives": state.primitives, "buttons_on": lit.copy(),
                "pressed": begun, "is_success": events.escaped}
