"""Your own puzzle: Lights Out in a row. A press toggles a light and its neighbours, and the exit opens when all are on.

A puzzle is a part of the room configuration (`PuzzleConfig`), rules as pure functions of a hashable state (`Puzzle`),
and a symbolic model for options, planners and PDDL. Publish it under the entry-point group `hrl_escape.puzzles`.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated

import tyro

from hrl_escape.checks import check_puzzle
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.base import Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class LightRowConfig(PuzzleConfig):
    """Number and size of the lights."""

    kind = "light-row"
    count: Annotated[int, Range(2, 12)] = 4
    """Number of lights, in a row."""
    buttons: Panels = Panels(width=1.5)
    """The panels to press."""


@dataclasses.dataclass(frozen=True)
class LightRow(Graphed, Modelled, Puzzle):
    """Lights in a row. The state is a tuple of bools, one per light."""

    kind = "light-row"
    count: Annotated[int, Range(2, 12)] = 4
    """Number of lights."""

    target_names = property(lambda self: tuple(f"light-{i + 1}" for i in range(self.count)))
    goal_targets = property(lambda self: tuple(range(self.count)))

    def make_state(self):
        """Return the state with all lights off."""
        return (False,) * self.count

    def update(self, state, contacts):
        """Toggle each pressed light and its neighbours."""
        for pressed in contacts.pressed:
            state = tuple(on != (abs(i - pressed) <= 1) for i, on in enumerate(state))
        return state

    def is_solved(self, state):
        """Return whether all lights are on."""
        return all(state)

    def observe(self, state):
        """Return 1 for each light that is on, else 0."""
        return tuple(map(float, state))

    def get_lit(self, state):
        """Return, for each light, whether it is on."""
        return state

    def get_facts(self, state):
        """Return the fact `on(light-i)` for each light that is on."""
        return frozenset(f"on({name})" for name, on in zip(self.target_names, state, strict=True) if on)

    def make_symbolic_model(self):
        """Make one operator for each press and each state of the lights that it toggles."""
        facts, operators = [f"on({name})" for name in self.target_names], []
        for i, name in enumerate(self.target_names):
            near = facts[max(0, i - 1) : i + 2]
            for ons in itertools.product((True, False), repeat=len(near)):
                lit = frozenset(fact for fact, on in zip(near, ons, strict=True) if on)
                dark = frozenset(near) - lit
                case = "".join("1" if on else "0" for on in ons)
                operators.append(Operator(f"press-{name}-{case}", name, "press", lit, dark, add=dark, delete=lit))
        return SymbolicModel(tuple(facts), tuple(operators), frozenset(facts))


register_puzzle(LightRowConfig, LightRow)


def main(count: int = 4, seed: int = 0, draw: Path = Path("light-row.svg")) -> None:
    """Check the puzzle, make a room with it, solve it and draw the escape.

    Args:
        count: number of lights.
        seed: instance seed.
        draw: file of the picture.
    """
    check_puzzle(LightRow(count))
    config = RoomConfig(name="light-row", puzzle=LightRowConfig(count), robot=RobotConfig(body_radius=0.5),
                           room=ShapeConfig(width=12, depth=12))
    room = generate(config, seed)
    plan = RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0]))
    print(plan)
    plan.draw(draw)


if __name__ == "__main__":
    tyro.cli(main)
