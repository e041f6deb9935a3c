"""Recorded episodes of an agent, primitive by primitive, for notebooks and reports."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.decisions import name_action
from hrl_escape.agents.spec import REFERENCES
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures.moving_map import embed_moving_map, make_frames, make_moving_map
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.figures import make_svg
from hrl_escape.notebook import make_caption
from hrl_escape.step_info import read_option


@dataclass(frozen=True, repr=False)
class RecordedEpisode:
    """Recorded episode in a room. Notebooks show it as an animation.

    Attributes:
        instance: the room.
        states: the first state, and the state after each primitive.
        decisions: name, number of primitives and ending (`reached`, `timeout`, ...) of each decision, in order.
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
        frame = embed_moving_map(self.instance, make_moving_map(self.instance, self.states, decisions))
        return make_caption(frame, repr(self).strip("<>"))

    def _repr_svg_(self) -> str:
        from hrl_escape.env.pictures.maps import Trajectory, make_map  # loads matplotlib

        path = [(state.x, state.y) for state in self.states]
        return make_svg(make_map(self.instance, self.states[-1], [Trajectory(path, "episode")]))

    def to_json(self) -> dict[str, Any]:
        """Return `return`, `primitives`, `success`, `decisions` and `frames` (see `make_frames`) as JSON values."""
        return {"return": self.total, "primitives": len(self.states) - 1, "success": self.success,
                "decisions": [list(decision) for decision in self.decisions],
                "frames": make_frames(Kinematics(self.instance), self.states)}


@contextmanager
def _recording(env: gymnasium.Env) -> Iterator[tuple[gymnasium.Env, StateRecorder]]:
    """Insert a recorder temporarily below all wrappers except Gymnasium's own, unless there is one."""
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
    """Play and record one greedy episode in a room.

    Args:
        agent: agent with frozen weights, or the name of a reference such as `search-nearest`.
        env: a room with any wrappers, such as an `OptionsEnv`.
        seed: episode seed.

    Raises:
        UnsupportedError: the environment is not a room.
        UnknownNameError: no such reference.
    """
    if isinstance(agent, str) and agent not in REFERENCES:
        raise UnknownNameError("reference", agent, REFERENCES)
    room: Any = env.unwrapped
    if not isinstance(getattr(room, "instance", None), RoomInstance):
        raise UnsupportedError(f"{room} is not a room: only episodes of rooms can be recorded")
    total, success = 0.0, False
    decisions: list[tuple[str, int, str]] = []
    with _recording(env) as (recorded, recorder):
        player = make_reference(agent, recorded, recorder) if isinstance(agent, str) else agent
        for transition, info in play_episode(player, recorded, seed):
            total += transition.summed_reward
            option = read_option(info) or {"name": name_action(room.instance.robot.actions.names, transition.action),
                                            "ended": "reached"}
            decisions.append((option["name"], transition.duration, option["ended"]))
            success = bool(info["is_success"])
        return RecordedEpisode(room.instance, tuple(recorder.states), tuple(decisions), total, success)
