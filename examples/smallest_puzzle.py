"""The smallest puzzle, solved by the planner. Each press toggles a light, and all lights must be on."""
# ruff: noqa: E731  # one-line rules fit on one screen

import dataclasses

from hrl_escape import RoomConfig, RoomPlanner, generate
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.base import Panels, Puzzle, PuzzleConfig, register_puzzle


@dataclasses.dataclass(frozen=True)
class TogglesConfig(PuzzleConfig):
    """Configuration without fields."""

    kind, panels = "toggles", Panels(width=1.5)


@dataclasses.dataclass(frozen=True)
class Toggles(Puzzle):
    """The state is an integer with one bit per light."""

    kind, target_names = "toggles", ("a", "b", "c")
    make_state = lambda self: 0
    update = lambda self, state, contacts: state ^ sum(1 << target for target in contacts.pressed)
    is_solved = lambda self, state: state == 7
    get_lit = lambda self, state: tuple(bool(state >> bit & 1) for bit in range(3))
    observe = lambda self, state: tuple(map(float, self.get_lit(state)))


register_puzzle(TogglesConfig, Toggles)
room = generate(RoomConfig(name="toggles", puzzle=TogglesConfig()), seed=0)
print(RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0])))
