"""Predicted course of an option from a state, by the room's kinematics; the room itself is not touched."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.options.execution import OptionExecution
from hrl_escape.options.meta_actions import make_meta_options
from hrl_escape.options.option import Option
from hrl_escape.planning.planner import get_planner

MOST = 400
"""Maximum number of primitives in a preview."""


class Preview(NamedTuple):
    """Predicted course of an option."""

    name: str  # name of the option
    states: tuple[RoomState, ...]  # all states, the first one included
    pressed: tuple[str, ...] = ()  # names of the targets pressed on the way
    escapes: bool = False  # the episode would end in the exit
    problem: str = ""  # reason why the option fails, else empty


class Previewer:
    """Predicts meta-actions of a room without noise, with options of its own so that no running option is disturbed.

    Args:
        instance: the room.
        options: its meta-actions; None for those of the flavour `press`.
    """

    def __init__(self, instance: RoomInstance, options: Iterable[Option] | None = None) -> None:
        self._planner = get_planner(instance)
        made = make_meta_options(instance, "press", self._planner) if options is None else options
        self.options = {option.name: option for option in made}
        self._instance = instance

    def preview(self, name: str, state: RoomState) -> Preview:
        """Predict an option from a state to its end, or until it fails."""
        option, rules = self.options[name], self._planner.rules
        if self._instance.dynamics.kind == "physics":
            state = state._replace(physics=None)
        if not option.initiation(state):
            return Preview(name, (state,), problem="it cannot start here")
        states, pressed, rng = [state], [], np.random.default_rng(0)
        try:
            run = OptionExecution(0, option, state, rng)
            while len(states) <= MOST:
                step = rules.step(states[-1], run.choose(states[-1]))
                states.append(step.state)
                pressed += [self._instance.targets[i].name for i in step.pressed]
                if step.terminated or run.ends_at(step.state):
                    escapes = rules.has_escaped(step.state)
                    problem = "the puzzle is failed" if step.terminated and not escapes else ""
                    return Preview(name, tuple(states), tuple(pressed), escapes, problem)
        except EscapeError as error:
            return Preview(name, tuple(states), tuple(pressed), problem=str(error))
        return Preview(name, tuple(states), tuple(pressed), problem=f"no end within {MOST} primitives")
