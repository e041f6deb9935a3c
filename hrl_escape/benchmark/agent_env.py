"""Environments of agents in comparisons: rooms with options, memory, trials and a recorder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.hierarchy_kinds import find_kind
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import UnsupportedError
from hrl_escape.sets.common_spaces import CommonSpaces, CommonSpacesEnv
from hrl_escape.sets.grammar import FreshRooms, NamedRooms
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.room_schedule import RoomSchedule
from hrl_escape.sets.room_sequence import RoomSequence
from hrl_escape.sets.sequence import SequenceEnv, compute_room_seed


def make_agent_env(agent: AgentSpec, rooms: NamedRooms, observation: str, schedule: Mapping[str, int] | None = None,
                   common: CommonSpaces | None = None, trials: int = 1) -> tuple[gymnasium.Env, StateRecorder]:
    """Make the environment of an agent and the recorder inside it.

    Args:
        agent: spec of the agent.
        rooms: a room, a set, a sequence, or fresh rooms.
        observation: name of the observation.
        schedule: episode seed -> number of the room in the set, or in each set of a sequence; other episodes draw a
            room.
        common: common spaces of rooms of several configurations.
        trials: number of trials in the same room per episode.

    Returns:
        The environment, and its recorder; of a sequence the recorder of the first room.
    """
    import hrl_escape  # noqa: F401  # registers the environment

    schedule = schedule or {}
    if isinstance(rooms, RoomSequence):
        (first, recorder), *others = (
            make_agent_env(
                agent, each, observation,
                {str(compute_room_seed(int(seed), place)): number for seed, number in schedule.items()}, common)
            for place, each in enumerate(rooms.sets))
        return SequenceEnv(first, then=[env for env, _ in others], paired=rooms.paired), recorder
    if isinstance(rooms, InstanceSet):
        if agent.drives_velocities:
            raise UnsupportedError(f"{agent.name} drives velocities, and a set of rooms has primitives: name one room, "
                                   f"such as {rooms.name}#0")
        flat = RoomSchedule(rooms.make_env(observation=observation),
                            {seed: number % len(rooms) for seed, number in schedule.items()})
    else:
        given: dict[str, Any] = {"config": rooms.config, "resample_instance": True} if isinstance(
            rooms, FreshRooms) else {"instance": rooms}
        name = "EscapeRoomContinuous-v1" if agent.drives_velocities else "EscapeRoom-v1"
        flat = gymnasium.make(f"hrl_escape/{name}", **given, observation=observation, disable_env_checker=True)
    recorder = StateRecorder(flat)
    if agent.low_level is not None:
        from hrl_escape.hierarchies.hierarchy_env import HierarchyEnv

        return HierarchyEnv(recorder, find_kind(agent.name), agent.low_level), recorder
    env = _add_options(agent, recorder, trials) if agent.chooses_options else _add_trials(recorder, trials)
    return (env if common is None else CommonSpacesEnv(env, *common)), recorder


def _add_trials(env: gymnasium.Env, trials: int) -> gymnasium.Env:
    return env if trials == 1 else SequenceEnv(env, trials)


def _add_options(agent: AgentSpec, recorder: StateRecorder, trials: int) -> gymnasium.Env:
    from hrl_escape.options.memory import DecisionMemory
    from hrl_escape.options.options_env import OptionsEnv  # loads the planners

    arguments = agent.options.to_dict()
    has_memory = arguments.pop("memory")
    env: gymnasium.Env = OptionsEnv(recorder, trace=agent.needs_trace, **arguments)
    if agent.name == TEXT_AGENT:
        from hrl_escape.text.text_env import TextEnv

        env = TextEnv(env, agent.resolve_settings()["reveal"])
    env = _add_trials(env, trials)
    return DecisionMemory(env) if has_memory else env


def make_player(agent: AgentSpec, env: gymnasium.Env, recorder: StateRecorder) -> Agent:
    """Make an agent without training, such as a reference, for an environment of `make_agent_env`."""
    if agent.is_frozen:
        return make_agent(agent, env.observation_space, env.action_space, seed=0)
    if agent.name != TEXT_AGENT:
        return make_reference(agent.name, env, recorder)
    from hrl_escape.text.managers import ToolsAgent, make_model

    return ToolsAgent(env, make_model(agent.resolve_settings()["model"]))


def find_starts(env: gymnasium.Env, recorder: StateRecorder, seeds: Sequence[int]
                 ) -> list[tuple[RoomInstance, RoomState]]:
    """Return room and first state of the episodes of these seeds; of a sequence for every room."""
    if isinstance(env, SequenceEnv):
        return [start for seed in seeds for place, part in enumerate(env.parts)
                for start in find_starts(part, find_recorder(part), [compute_room_seed(seed, place)])]
    room: Any = env.unwrapped
    starts = []
    for seed in seeds:
        env.reset(seed=seed)
        starts.append((room.instance, recorder.states[0]))
    return starts
