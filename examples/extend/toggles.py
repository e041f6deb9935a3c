"""A puzzle: each press toggles a light, and all lights must be on."""

import dataclasses

from hrl_escape.env.puzzles.base import Panels, Puzzle, PuzzleConfig


@dataclasses.dataclass(frozen=True)
class TogglesConfig(PuzzleConfig):
    """The part of the room configuration."""

    kind, panels = "toggles", Panels(width=1.5)


@dataclasses.dataclass(frozen=True)
class Toggles(Puzzle):
    """The state is a number whose bits are the lights."""

    kind, target_names = "toggles", ("a", "b", "c")

    def update(self, state, contacts):
        """Return the state after the presses of a primitive."""
        return state ^ sum(1 << target for target in contacts.pressed)

    def is_solved(self, state):
        """Return whether all lights are on."""
        return state == 7

    def get_lit(self, state):
        """Return which lights are on."""
        return tuple(bool(state >> bit & 1) for bit in range(3))

    def observe(self, state):
        """Return the lights as numbers."""
        return tuple(map(float, self.get_lit(state)))


KIND = TogglesConfig, Toggles
