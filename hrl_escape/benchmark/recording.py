"""Recorded episodes of an agent, primitive by primitive, which a notebook or a report plays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import REFERENCES
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures.moving_map import embed_moving_map, make_frames, make_moving_map
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.step_info import read_option


@dataclass(frozen=True, repr=False)
class RecordedEpisode:
    """A played episode of a room. In a notebook it plays itself.

    Attributes:
        instance: the room.
        states: the first one, and one a primitive.
        decisions: name, number of primitives and how it ended (`reached`, `timeout`, ...) of each, in order.
        total: undiscounted return.
        success: the robot escaped.
    """

    instance: RoomInstance
    states: tuple[RoomState, ...]
    decisions: tuple[tuple[str, int, str], ...]
    total: float
    success: bool

    def __repr__(self) -> str:
        end = "escaped" if self.success else "no escape"
        lengths = f"{len(self.states) - 1} primitives in {len(self.decisions)} decisions"
        return f"<RecordedEpisode in {self.instance.name}: {end}, {lengths}, return {self.total:g}>"

    def _repr_html_(self) -> str:
        decisions = [(name, count) for name, count, _ in self.decisions]
        return embed_moving_map(self.instance, make_moving_map(self.instance, self.states, decisions))

    def to_json(self) -> dict[str, Any]:
        """Return `return`, `primitives`, `success`, `decisions` and `frames` (see `make_frames`) as JSON values."""
        return {"return": self.total, "primitives": len(self.states) - 1, "success": self.success,
                "decisions": [list(decision) for decision in self.decisions],
                "frames": make_frames(Kinematics(self.instance), self.states)}


@contextmanager
def _recording(env: gymnasium.Env) -> Iterator[tuple[gymnasium.Env, StateRecorder]]:
    """Put a recorder below all wrappers but Gymnasium's own for the time being, unless there is one."""
    lowest, inner = None, env
    while isinstance(inner, gymnasium.Wrapper):
        if isinstance(inner, StateRecorder):
            yield env, inner
            return
        lowest = lowest if type(inner).__module__.startswith("gymnasium.") else inner
        inner = inner.env
    if lowest is None:
        recorder = StateRecorder(env)
        yield recorder, recorder
        return
    below = lowest.env
    recorder = lowest.env = StateRecorder(below)
    try:
        yield env, recorder
    finally:
        lowest.env = below


def record_episode(agent: Agent | str, env: gymnasium.Env, seed: int = 0) -> RecordedEpisode:
    """Play one greedy episode of a room and keep it.

    Args:
        agent: acts with frozen weights; or the name of a reference, such as `search-nearest`.
        env: a room, or what wraps one, such as an `OptionsEnv`; reset with `seed` first.
        seed: the episode's.

    Raises:
        UnsupportedError: the environment is no room.
        UnknownNameError: no reference has this name.
    """
    if isinstance(agent, str) and agent not in REFERENCES:
        raise UnknownNameError("reference", agent, REFERENCES)
    room: Any = env.unwrapped
    if not isinstance(getattr(room, "instance", None), RoomInstance):
        raise UnsupportedError(f"{room} is no room: only episodes of rooms are recorded")
    total, success = 0.0, False
    decisions: list[tuple[str, int, str]] = []
    with _recording(env) as (recorded, recorder):
        player = make_reference(agent, recorded, recorder) if isinstance(agent, str) else agent
        for transition, info in play_episode(player, recorded, seed):
            total += transition.summed_reward
            option = read_option(info) or {"name": room.instance.robot.actions.names[transition.action],
                                            "ended": "reached"}
            decisions.append((option["name"], transition.duration, option["ended"]))
            success = bool(info["is_success"])
        return RecordedEpisode(room.instance, tuple(recorder.states), tuple(decisions), total, success)
