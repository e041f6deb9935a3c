"""The smallest puzzle, 26 lines, solved by a planner. Each press toggles a light, and all must be on."""
# ruff: noqa: E731  # rules as one-liners, so that all of them are seen at once

import dataclasses

from hrl_escape import RoomConfig, RoomPlanner, generate
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.base import Operator, Panels, Puzzle, PuzzleConfig, SymbolicModel, register_puzzle

NONE = frozenset()


@dataclasses.dataclass(frozen=True)
class TogglesConfig(PuzzleConfig):
    """The schematic, which has no knobs."""

    kind, panels = "toggles", Panels(width=1.5)
    make_puzzle = lambda self, rng: Toggles()


@dataclasses.dataclass(frozen=True)
class Toggles(Puzzle):
    """The state is a number whose bits are the lights."""

    kind, target_names, bounds = "toggles", ("a", "b", "c"), ((0.0, 1.0),) * 3
    make_state = lambda self: 0
    update = lambda self, state, contacts: state ^ sum(1 << target for target in contacts.pressed)
    is_solved = lambda self, state: state == 7
    get_lit = lambda self, state: tuple(bool(state >> bit & 1) for bit in range(3))
    observe = lambda self, state: tuple(map(float, self.get_lit(state)))

    def get_facts(self, state):
        """The lights that are on."""
        return frozenset(name for name, lit in zip(self.target_names, self.get_lit(state), strict=True) if lit)

    def make_symbolic_model(self):
        """The planner's model: a press turns a light on that was off."""
        press = [Operator(f"press-{name}", name, "press", NONE, frozenset({name}), frozenset({name}), NONE)
                 for name in self.target_names]
        return SymbolicModel(self.target_names, tuple(press), frozenset(self.target_names))


register_puzzle(TogglesConfig, Toggles)
room = generate(RoomConfig(name="toggles", puzzle=TogglesConfig()), seed=0)
print(RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0])))
