"""What a puzzle is: the rules that must be solved before the exit opens (paper, section 5.1).

A puzzle sees contacts and keeps state; it declares its observation numbers, what is lit,
whether it is solved, and a symbolic model that planners read and agents never see. It knows
no engine and no geometry beyond the panels and props it asks the room to place.
Third-party puzzles register through the entry-point group `hrl_escape.puzzles`.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Hashable
from importlib.metadata import entry_points
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hrl_escape.env.settings import Settings, knob
from hrl_escape.errors import ConfigError, PluginError, UnknownNameError

__all__ = [
    "Contacts",
    "Operator",
    "Panels",
    "Place",
    "Prop",
    "Puzzle",
    "PuzzleConfig",
    "PuzzleKind",
    "SymbolicModel",
    "get_puzzle_kind",
    "list_puzzles",
    "register_puzzle",
]

PuzzleState = Hashable


class Contacts(NamedTuple):
    """What happened to a puzzle's things during one primitive.

    Attributes:
        pressed: indices of targets whose touching began at this primitive's end, ascending.
        prop_poses: (x, y, yaw) of each prop in the room frame, metres and radians; they
            move under physics dynamics only. A puzzle with props is told where they stand
            once before the first primitive, with nothing pressed.
    """

    pressed: tuple[int, ...]
    prop_poses: tuple[tuple[float, float, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class Operator:
    """One symbolic action: a STRIPS operator over propositions.

    Attributes:
        name: verb phrase, such as `press-button-2`.
        target: name of the target or prop it acts on.
        action: what to do with it: `press` a target, or `push` a prop to `destination`.
        preconditions: propositions that must hold.
        forbidden: propositions that must not hold.
        add: propositions made true.
        delete: propositions made false.
        destination: name of the prop that `target` is pushed onto, if `action` is `push`.
    """

    name: str
    target: str
    action: str
    preconditions: frozenset[str]
    forbidden: frozenset[str]
    add: frozenset[str]
    delete: frozenset[str]
    destination: str | None = None

    def is_applicable(self, facts: frozenset[str]) -> bool:
        """Say whether the operator may be applied where `facts` hold."""
        return self.preconditions <= facts and not self.forbidden & facts

    def apply(self, facts: frozenset[str]) -> frozenset[str]:
        """Return the facts after applying the operator."""
        return (facts - self.delete) | self.add


@dataclasses.dataclass(frozen=True)
class SymbolicModel:
    """A puzzle as planners see it: propositions, operators, and the facts that solve it."""

    propositions: tuple[str, ...]
    operators: tuple[Operator, ...]
    goal: frozenset[str]


@dataclasses.dataclass(frozen=True)
class Place(Settings):
    """An explicit place of a panel's centre.

    `yaw_deg` is the direction of its width; `z` None takes the panels' `centre_height`.
    """

    _section = "place"
    x: float = knob(0.0, "Centre.", "m", -110, 110)
    y: float = knob(0.0, "Centre.", "m", -110, 110)
    yaw_deg: float = knob(0.0, "Direction of the width, counter-clockwise from +x.", "deg", -360, 360)
    z: float | None = knob(None, "Height of the centre.", "m", 0, 50)


@dataclasses.dataclass(frozen=True)
class Panels(Settings):
    """Size and places of the things on the walls that can be pressed (boxes)."""

    _section = "panels"
    width: float = knob(1.0, "Size along the wall.", "m", 0.02, 200)
    height: float = knob(1.0, "Vertical size.", "m", 0.02, 50)
    thickness: float = knob(0.1, "Size away from the wall.", "m", 0.005, 10)
    centre_height: float = knob(0.75, "Height of the centre.", "m", 0, 50)
    height_spread: float = knob(0.0, "Centres vary by up to this, up and down.", "m", 0, 50)
    inset: float | None = knob(None, "Distance of the centre from its wall (None: flush).", "m", 0, 50)
    places: str | tuple[Place, ...] = knob(
        "random", "Anywhere on the walls, the paper's four places, or explicit ones.", choices=("random", "paper")
    )

    def check_places(self, count: int) -> None:
        """Check that there are places for a number of panels.

        Raises:
            ConfigError: there are fewer.
        """
        if self.places == "paper" and count > 4:
            raise ConfigError("puzzle.count", count, "at most 4 with panels.places = 'paper'")
        if isinstance(self.places, tuple) and len(self.places) < count:
            raise ConfigError("panels.places", len(self.places), f"at least puzzle.count = {count} places")


@dataclasses.dataclass(frozen=True)
class Prop(Settings):
    """A thing on the floor: a movable block (physics dynamics), or a flat plate."""

    _section = "prop"
    name: str = knob("block", "Unique name.")
    kind: str = knob("block", "Movable solid, or flat region.", choices=("block", "plate"))
    half_size: float = knob(0.3, "Half its side; the footprint is a square.", "m", 0.05, 10)
    height: float = knob(0.4, "Height (blocks).", "m", 0.01, 10)
    mass: float = knob(5.0, "Mass (blocks).", "kg", 0.01, 10_000)


@dataclasses.dataclass(frozen=True)
class PuzzleConfig(Settings, ABC):
    """The puzzle's part of the schematic; `make_puzzle` draws what is random in it."""

    kind: ClassVar[str]
    needs_physics: ClassVar[bool] = False
    _section = "puzzle"

    @abstractmethod
    def make_puzzle(self, rng: np.random.Generator) -> Puzzle:
        """Sample a concrete puzzle (a graph, say) from this schematic."""

    @property
    def panels(self) -> Panels | None:
        """Where and how large the puzzle's targets are; None where it has none."""
        return None


@dataclasses.dataclass(frozen=True)
class Puzzle(Settings, ABC):
    """A concrete puzzle: the rules, as pure functions of its hashable state.

    Attributes:
        kind: registered name.
        target_names: names of the things that can be pressed, in index order.
        props: things on the floor.
    """

    kind: ClassVar[str]
    _section = "puzzle"

    @property
    @abstractmethod
    def target_names(self) -> tuple[str, ...]:
        """Names of the things that can be pressed; the index is the target's number."""

    @property
    def props(self) -> tuple[Prop, ...]:
        """Things on the floor that the room must place."""
        return ()

    @abstractmethod
    def make_state(self) -> PuzzleState:
        """Return the state at the start of an episode."""

    @abstractmethod
    def update(self, state: PuzzleState, contacts: Contacts) -> PuzzleState:
        """Return the state after one primitive's contacts; presses count in index order."""

    @abstractmethod
    def is_solved(self, state: PuzzleState) -> bool:
        """Say whether the exit is open."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest value of each of the N_p observation numbers."""

    @abstractmethod
    def observe(self, state: PuzzleState) -> tuple[float, ...]:
        """Return the N_p observation numbers, within `bounds`."""

    @abstractmethod
    def get_lit(self, state: PuzzleState) -> tuple[bool, ...]:
        """Say for each target whether it is on."""

    @abstractmethod
    def get_facts(self, state: PuzzleState) -> frozenset[str]:
        """Return the propositions of the symbolic model that hold."""

    @abstractmethod
    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model that planners, option synthesis and PDDL export read."""

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child) between targets, for drawings."""
        return ()

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Targets that must be on in the end, for drawings."""
        return ()


@dataclasses.dataclass(frozen=True)
class PuzzleKind:
    """A registered puzzle: its schematic part and its rules."""

    config_type: type[PuzzleConfig]
    puzzle_type: type[Puzzle]


_REGISTRY: dict[str, PuzzleKind] = {}
_ENTRY_POINTS = "hrl_escape.puzzles"


def register_puzzle(config_type: type[PuzzleConfig], puzzle_type: type[Puzzle]) -> None:
    """Make a puzzle known under its `kind`.

    Raises:
        ConfigError: the two types differ in `kind`, or another puzzle has that name.
    """
    kind = config_type.kind
    if puzzle_type.kind != kind:
        raise ConfigError("puzzle.kind", puzzle_type.kind, f"the same name as its config's, {kind!r}")
    entry = PuzzleKind(config_type, puzzle_type)
    if _REGISTRY.setdefault(kind, entry) != entry:
        raise ConfigError("puzzle.kind", kind, "a name that no other puzzle has")


def get_puzzle_kind(kind: Any) -> PuzzleKind:
    """Look a puzzle up by name, loading third-party entry points when needed.

    Raises:
        UnknownNameError: no puzzle of that name; the message lists those there are.
    """
    if kind not in _REGISTRY:
        _load_entry_points()
    if not isinstance(kind, str) or kind not in _REGISTRY:
        raise UnknownNameError("puzzle", kind, _REGISTRY)
    return _REGISTRY[kind]


def list_puzzles() -> tuple[str, ...]:
    """Return the names of all puzzles, third-party ones included."""
    _load_entry_points()
    return tuple(sorted(_REGISTRY))


def _load_entry_points() -> None:
    for point in entry_points(group=_ENTRY_POINTS):
        try:
            config_type, puzzle_type = point.load()
        except Exception as error:  # whatever a stranger's module raises
            package = point.dist.name if point.dist else "an unknown package"
            raise PluginError(f"the puzzle {point.name!r} of package {package!r} cannot be loaded from "
                              f"{point.value!r}, which must be a pair (config type, puzzle type): {error}") from error
        register_puzzle(config_type, puzzle_type)
