"""Recorder of a room's states in an episode, with progress and callbacks for every primitive.

Recording does not change the environment; it adds `progress` to its `info`. A callback can stop the episode by raising.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium

from hrl_escape.agents.decisions import to_plain_action
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.env.rewards import Events
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.domain import find_layer


class PrimitiveStep(NamedTuple):
    """A primitive and its transition."""

    before: RoomState
    primitive: Any  # its number, or velocities
    after: RoomState
    reward: float
    events: Events
    end: EpisodeEnd

    @property
    def pressed(self) -> tuple[int, ...]:
        """Numbers of the targets that the primitive pressed, in ascending order."""
        return list_touched(self.events.pressed)


class StateRecorder(gymnasium.Wrapper):
    """Wrapper between a room and its `OptionsEnv` that records the states of the current episode.

    `info["progress"]` is the largest `compute_progress` of the puzzle so far in the episode; 1 once the robot has
    escaped.

    Attributes:
        states: the first state, and the state after each primitive.
        events: events of each primitive.
        starts: first states of all episodes since the last reset with a seed.
        on_step: called after every primitive, including primitives of options.
        before_step: called before every primitive.
        on_reset: called with the first state of an episode.
    """

    is_passive = True  # it does not affect a run

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.states: list[RoomState] = []
        self.events: list[Events] = []
        self.starts: list[RoomState] = []
        self.on_step: Callable[[PrimitiveStep], None] | None = None
        self.before_step: Callable[[], None] | None = None
        self.on_reset: Callable[[RoomState], None] | None = None
        self._progress = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset, and begin a new record."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.states, self.events = [self._get_state()], []
        self.starts = [*([] if seed is not None else self.starts), self.states[0]]
        self._progress = self._measure_progress()
        if self.on_reset is not None:
            self.on_reset(self.states[0])
        return observation, {**info, "progress": self._progress}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and record the state reached."""
        if self.before_step is not None:
            self.before_step()
        before = None if self.on_step is None else self._get_state()
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.states.append(self._get_state())
        self.events.append(self._get_room().events)
        if self.states[-1].puzzle != self.states[-2].puzzle:
            self._progress = max(self._progress, self._measure_progress())
        self._progress = 1.0 if info["is_success"] else self._progress
        if self.on_step is not None and before is not None:
            self.on_step(PrimitiveStep(before, to_plain_action(action), self.states[-1], float(reward),
                                       self.events[-1],
                                       EpisodeEnd.of_step(bool(info["is_success"]), terminated, truncated)))
        return observation, reward, terminated, truncated, {**info, "progress": self._progress}

    def _measure_progress(self) -> float:
        return self._get_room().instance.puzzle.compute_progress(self.states[-1].puzzle)

    def _get_state(self) -> RoomState:
        return self._get_room().get_state()

    def _get_room(self) -> Any:
        return self.env.unwrapped


def find_recorder(env: gymnasium.Env) -> StateRecorder:
    """Find the recorder among the wrappers of a room.

    Raises:
        UnsupportedError: no recorder among the wrappers.
    """
    found = find_layer(env, StateRecorder)
    if found is None:
        raise UnsupportedError(f"nothing records the states of {env}")
    return found
