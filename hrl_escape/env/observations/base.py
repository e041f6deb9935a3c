"""Interface and registry of observations. A class turns a state into numbers and, for a batch, all states at once.

Packages register observations through the entry-point group `hrl_escape.observations`. This module does not import
torch; the batched form imports it when called.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, TypeAlias

from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import UnsupportedError
from hrl_escape.registry import Registry

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.env.tensor_geometry import Shapes


class BatchView(Protocol):
    """View of a batch of rooms for observations; the last axis of every tensor is the room."""

    x: Tensor  # x of the bases' axes, m, float64 (rooms,)
    y: Tensor  # y of the bases' axes, m, float64 (rooms,)
    heading: Tensor  # rad, within [-pi, pi), float64 (rooms,)
    rotation: tuple[Tensor, Tensor]  # cosine and sine of the heading, float64 (rooms,) each
    angles: Tensor  # joint angles, rad, float64 (joints, rooms)
    limits: tuple[tuple[float, float], ...]  # lowest and highest angle of each joint, rad
    puzzle: Tensor  # observation numbers of the puzzle, float32 (numbers, rooms)
    is_solved: Tensor  # true if the exit is open, bool (rooms,)
    half_sizes: tuple[Tensor, Tensor]  # largest |x| and |y| of the floor in the frame, m, float32 (rooms,) each
    targets: Shapes  # outlines of the targets, m, float64 (targets, rooms) each
    is_present: Tensor  # true for the targets that an instance has, bool (targets, rooms)
    lit: Tensor  # true for the targets that are on, bool (targets, rooms)
    cues: Tensor  # numbers of the targets' cues, float32 (targets, `CUE_WORDS`, rooms), of width 0 without cues
    are_cells: bool  # true if the targets are cells of a map
    exit: tuple[Tensor, Tensor, Tensor, Tensor]  # x_min, x_max, y_min and y_max, m, float64 (rooms,) each

    def cast_rays(self, ray_x: Tensor, ray_y: Tensor, among: Literal["solids", "hiders"]) -> Tensor:
        """Return the range of rays (rays, 1, rooms), m, to the first outline or shut door, float64 (rays, rooms).

        Args:
            ray_x: x of the unit directions.
            ray_y: y of the unit directions.
            among: `solids` for everything solid, `hiders` for solids that can hide one place from another.
        """
        ...


BatchObservation: TypeAlias = "Callable[[BatchView], list[Tensor]]"
"""Parts of the observation of every room, float32 (numbers, rooms) each."""


class Observer(ABC):
    """Turns states of one room into observations of one kind.

    Args:
        rules: the room's rules.
        renderer: renderer of the engine, for pictures.

    Attributes:
        name: value of the argument `observation=`.
        doc: one line for lists and docs.
        is_vector: whether the observation is a vector of named numbers, which every agent supports.
        names: name of each number, in order; empty for pictures.
        low: smallest value of each number, in the shape and dtype of the observation.
        high: largest value of each number.
        rows: name of the object of each row at the beginning of the vector; empty for most kinds.
        words: name of each number in a row.
    """

    name: ClassVar[str]
    doc: ClassVar[str]
    is_vector: ClassVar[bool] = True
    names: tuple[str, ...]
    low: NDArray[Any]
    high: NDArray[Any]
    rows: tuple[str, ...] = ()
    words: tuple[str, ...] = ()

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        self._rules = rules
        self._instance = rules.instance
        self._puzzle = rules.instance.puzzle
        self._frame = rules.instance.frame
        self._puzzle_names = tuple(f"puzzle-{i + 1}" for i in range(len(self._frame.bounds)))
        self._joint_names = tuple(f"joint-{i + 1}" for i in range(rules.instance.robot.joints))
        self._joint_limits = [max(abs(low), abs(high)) for low, high in rules.robot.limits]
        self._seen: dict[Any, tuple[float, ...]] = {}

    @abstractmethod
    def observe(self, state: RoomState) -> NDArray[Any]:
        """Return a new array with the shape and dtype of `low`."""

    @staticmethod
    def observe_batch(rooms: BatchView) -> list[Tensor]:
        """Return parts of the observation of every room, float32 (numbers, rooms) each; unsupported by default."""
        raise UnsupportedError("this observation does not support batches; use EscapeRoomEnv, or another observation")

    @property
    def light_places(self) -> tuple[int, ...]:
        """Index of each target's light in the observation, in the order of targets; empty without such numbers."""
        names = {name: place for place, name in enumerate(self.names)}
        if "puzzle-1" in names:
            return tuple(names["puzzle-1"] + number for number in self._puzzle.light_numbers)
        lights = [f"{name}-lit" for name in self._puzzle.target_names]
        return tuple(names[light] for light in lights) if not self.rows and names.keys() >= set(lights) else ()

    def _get_puzzle(self, state: RoomState) -> tuple[float, ...]:
        """The puzzle's numbers in the form of this observation, cached because puzzles change rarely."""
        numbers = self._seen.get(state.puzzle)
        if numbers is None:
            if len(self._seen) > 4096:  # states of a continuous puzzle rarely repeat
                self._seen.clear()
            numbers = self._scale_puzzle(self._puzzle.observe(state.puzzle))
            numbers += (0.0,) * (len(self._frame.bounds) - len(numbers))  # numbers of absent targets
            self._seen[state.puzzle] = numbers
        return numbers

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return numbers


def clip(value: float) -> float:
    """Clip a number to [-1, 1]."""
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value


# --- the registry --------------------------------------------------------------------------

observations: Registry[type[Observer]] = Registry(
    "observation", "a subclass of Observer", lambda part: isinstance(part, type) and issubclass(part, Observer))
"""All observations by name."""


def register_observation(observer: type[Observer]) -> None:
    """Register an observation under its `name`.

    Raises:
        ConfigError: the name is taken.
    """
    observations.register(observer.name, observer)


def get_observation(name: str) -> type[Observer]:
    """Return an observation by name, including entry points of other packages.

    Raises:
        UnknownNameError: no observation of that name; the message lists the valid names.
    """
    return observations.get(name)


def list_observations() -> tuple[type[Observer], ...]:
    """Return all observations, including entry points of other packages."""
    return tuple(observations.load_all().values())


def make_observer(name: str, rules: Rules, renderer: Renderer | None = None) -> Observer:
    """Make the observer of a room by name.

    Raises:
        UnknownNameError: no observation of that name.
        UnsupportedError: the observation is a picture and there is no renderer.
    """
    return get_observation(name)(rules, renderer)
