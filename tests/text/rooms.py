"""Rooms of the ladder, and ways to play them, for the tests of the tools."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets import make_room
from hrl_escape.text import RoomSession, TextEnv, ToolsAgent, make_model

RUNGS = ("doormat", "pair", "chain-3", "doors", "lattice-5", "drift", "code", "freight", "clutter", "switchboard",
         "lattice")


@lru_cache
def get_room(rung: str, number: int = 0) -> RoomInstance:
    return make_room(f"ladder-1/{rung}/test#{number}")


def make_env(room: RoomInstance, **options: Any) -> tuple[OptionsEnv, StateRecorder]:
    recorder = StateRecorder(EscapeRoomEnv(instance=room))
    return OptionsEnv(recorder, **options), recorder


def make_session(room: RoomInstance, reveal: Any = "places", seed: int = 0, **options: Any) -> RoomSession:
    session = RoomSession(make_env(room, **options)[0], reveal)
    session.reset(seed=seed)
    return session


def play_reference(name: str, room: RoomInstance, seed: int, reveal: Any = None
                   ) -> tuple[list[RoomState], TextEnv | None]:
    """States of a reference's episode, with its transcript where it has one."""
    env, recorder = make_env(room)
    outer = env if reveal is None else TextEnv(env, reveal)
    for _ in play_episode(make_reference(name, env, recorder), outer, seed):
        pass
    return recorder.states, None if reveal is None else outer  # type: ignore[return-value]


def play_manager(name: str, room: RoomInstance, seed: int, reveal: Any) -> tuple[list[RoomState], TextEnv]:
    """States and transcript of an episode in which a manager calls the tools."""
    env, recorder = make_env(room)
    outer = TextEnv(env, reveal)
    for _ in play_episode(ToolsAgent(outer, make_model(name)), outer, seed):
        pass
    return recorder.states, outer
