"""Engines: the protocols of an engine and its renderer, and the factory that makes them.

An engine moves one room; `EscapeRoomEnv` runs on it. `engines.register` adds an engine, whose modules are imported when
they are first used. Batches of rooms are in `vector_env.py` and `torchrl_env.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pkgutil import resolve_name
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Glide, RoomState, Rules, Transition
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.registry import Registry

CAMERAS: dict[str, str] = {
    "chase": "follows the robot from behind and above; walls in the way are cut open",
    "overhead": "the whole floor from straight above, y upwards",
    "robot": "ahead from the front of the robot; the view of the pixels observation",
}


LARGEST_SIDE = 2048
"""Largest side of a picture, pixels."""


class Engine(Protocol):
    """Protocol of an engine: one room that moves.

    Attributes:
        instance: the room.
        rules: the rules of the room; `rules.actions` is the action table.
        state: current state, immutable; keeping a reference saves it.
    """

    instance: RoomInstance
    rules: Rules
    state: RoomState

    def reset(self, start: Start, noise_key: int = 0) -> RoomState:
        """Begin an episode at a start with a 64-bit key for its noise."""
        ...

    def set_state(self, state: RoomState) -> None:
        """Continue from a state, exactly as the engine that returned it."""
        ...

    def step(self, action: int) -> Transition:
        """Apply one primitive, an index of `rules.actions` that the engine does not check."""
        ...

    def glide(self, motion: Glide) -> Transition:
        """Apply a short motion in continuous coordinates instead of a primitive."""
        ...

    def show(self, rate: float) -> None:
        """Limit the window to `rate` frames a second: wait until 1 / `rate` seconds after the last call."""
        ...

    def close(self) -> None:
        """Free all resources. Further calls have no effect."""
        ...


class Renderer(Protocol):
    """Protocol of a renderer of one room."""

    def render(self, state: RoomState, camera: str, width: int, height: int, *,
               trail: Sequence[tuple[float, float]] = ()) -> NDArray[np.uint8]:
        """Take a picture of the room in a state.

        Args:
            state: a state of the room's engine.
            camera: a name in `CAMERAS`.
            width: pixels, from 8 to 2048.
            height: pixels, from 8 to 2048.
            trail: positions (x, y) of the robot so far, drawn as a ribbon on the floor.

        Returns:
            Shape (height, width, 3), uint8, RGB.

        Raises:
            UnknownNameError: no camera of that name.
            ConfigError: invalid size.
        """
        ...


class EngineEntry(NamedTuple):
    """Import paths `module:name` of an engine."""

    engine: str  # called with the instance, and `window=True` to open a window
    renderer: str  # called with the instance


engines: Registry[EngineEntry] = Registry(
    "engine", "an EngineEntry", lambda part: isinstance(part, EngineEntry))
"""Engines by name."""
engines.register(
    "bullet", EngineEntry("hrl_escape.env.bullet.engine:BulletRoom", "hrl_escape.env.bullet.cameras:BulletRenderer"))


def make_engine(instance: RoomInstance, engine: str = "bullet", *, window: bool = False) -> Engine:
    """Make an engine for a room; it begins an episode at the first start of the instance.

    Args:
        instance: the room.
        engine: a name in `engines`.
        window: open the engine's own window (needs a display).

    Raises:
        UnknownNameError: no engine of that name.
        UnsupportedError: a window without a display, a gripper under physics, or too many rooms open in this process.
    """
    return resolve_name(engines.get(engine).engine)(instance, window=window)


class LateRenderer:
    """Renderer that is made for its first picture, so that rooms step without what their pictures need."""

    def __init__(self, instance: RoomInstance, place: str) -> None:
        self._instance, self._place = instance, place

    @cached_property
    def _renderer(self) -> Renderer:
        return resolve_name(self._place)(self._instance)

    def render(self, state: RoomState, camera: str, width: int, height: int, *,
               trail: Sequence[tuple[float, float]] = ()) -> NDArray[np.uint8]:
        """Take a picture of the room in a state; see `Renderer`."""
        return self._renderer.render(state, camera, width, height, trail=trail)


def make_renderer(instance: RoomInstance, engine: str = "bullet") -> Renderer:
    """Make a renderer of a room. It imports its modules and allocates resources with its first picture."""
    return LateRenderer(instance, engines.get(engine).renderer)


def check_camera(camera: str) -> None:
    """Raise `UnknownNameError` unless a camera of that name exists."""
    if not isinstance(camera, str) or camera not in CAMERAS:
        raise UnknownNameError("camera", camera, CAMERAS)


def check_picture_size(width: int, height: int) -> None:
    """Raise `ConfigError` unless pictures can have that size."""
    for name, pixels in (("width", width), ("height", height)):
        if isinstance(pixels, bool) or not isinstance(pixels, (int, np.integer)) or not 8 <= pixels <= LARGEST_SIDE:
            raise ConfigError(f"render_size.{name}", pixels, f"a whole number from 8 to {LARGEST_SIDE} pixels")


def film(instance: RoomInstance, states: Iterable[RoomState], camera: str = "chase", width: int = 480,
         height: int = 360, *, trail: bool = True) -> Iterator[NDArray[np.uint8]]:
    """Take a picture of each of an episode's states, for `save_video` and strips of pictures.

    Args:
        instance: the room.
        states: as an environment's `get_state` gave them.
        camera: a name in `CAMERAS`.
        width: pixels.
        height: pixels.
        trail: draw the path so far.

    Yields:
        Frames (height, width, 3), uint8.
    """
    renderer, points = make_renderer(instance), []
    for state in states:
        points.append((state.x, state.y))
        yield renderer.render(state, camera, width, height, trail=points if trail else ())
