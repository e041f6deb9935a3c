"""A new puzzle in 50 lines.

A puzzle is a set of rules: the effect of a press, and the condition that opens the exit. This one is a combination
lock. The buttons must be pressed in one fixed order, and a wrong press resets it.
"""

import dataclasses
from typing import Annotated

from hrl_escape import RoomConfig, RoomPlanner, generate
from hrl_escape.checks import check_puzzle
from hrl_escape.env import Kinematics, Operator, Panels, Puzzle, PuzzleConfig, SymbolicModel, register_puzzle
from hrl_escape.env.config import RobotConfig, ShapeConfig
from hrl_escape.settings import Range

# The configuration declares the settings and draws what is random, here the order.


@dataclasses.dataclass(frozen=True)
class LockConfig(PuzzleConfig):
    """How many buttons the lock has."""

    kind = "lock"
    count: Annotated[int, Range(2, 9)] = 4
    """Number of buttons."""
    panels = property(lambda self: Panels(width=1.5))

    def make_puzzle(self, rng):
        """Draw the combination."""
        return Lock(tuple(int(i) for i in rng.permutation(self.count)))


# The rules are pure functions of a hashable state, here the number of correct presses so far.


@dataclasses.dataclass(frozen=True)
class Lock(Puzzle):
    """Press the buttons in one order."""

    kind = "lock"
    order: tuple[Annotated[int, Range(0, 8)], ...] = (0, 1)
    """The combination."""
    target_names = property(lambda self: tuple(f"button-{i + 1}" for i in range(len(self.order))))
    bounds = property(lambda self: ((0.0, float(len(self.order))),))

    def make_state(self):
        """Nothing is pressed."""
        return 0

    def update(self, state, contacts):
        """On with the right button, back to nothing with a wrong one."""
        for pressed in contacts.pressed:
            if state < len(self.order):
                state = state + 1 if pressed == self.order[state] else int(pressed == self.order[0])
        return state

    def is_solved(self, state):
        """All in order."""
        return state == len(self.order)

    def observe(self, state):
        """How far the lock has come."""
        return (float(state),)

    def get_lit(self, state):
        """Those that count."""
        return tuple(i in self.order[:state] for i in range(len(self.order)))

    def get_facts(self, state):
        """The step that the lock is at."""
        return frozenset({f"at({state})"})

    def make_symbolic_model(self):
        """One operator a step. Planners read it and agents never do."""
        facts = [f"at({step})" for step in range(len(self.order) + 1)]
        steps = [Operator(f"press-{step}", self.target_names[button], "press", frozenset({facts[step]}), frozenset(),
                          add=frozenset({facts[step + 1]}), delete=frozenset({facts[step]}))
                 for step, button in enumerate(self.order)]
        return SymbolicModel(tuple(facts), tuple(steps), frozenset({facts[-1]}))


# Register and check the puzzle. Rooms, options, planners and agents then support it.

register_puzzle(LockConfig, Lock)
check_puzzle(Lock((2, 0, 1)))

config = RoomConfig(puzzle=LockConfig(4), robot=RobotConfig(body_radius=0.5), room=ShapeConfig(width=12, depth=12))
room = generate(config, seed=2)
print("combination:", ", ".join(room.puzzle.target_names[i] for i in room.puzzle.order))
plan = RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0]))
print("plan:", ", then ".join(part.name for part in plan.parts))
print(f"escape in {plan.cost} primitives, return {plan.compute_return():g}")
plan
