"""Drivers of watch mode: the oracle, another reference, the agent of a finished run, or one in training.

Each becomes an agent in an environment made as in training. This module displays nothing.

The oracle follows one plan of the whole escape, leg by leg. With noise, slips or pushed blocks, the whole escape cannot
be predicted. The oracle then takes the next goal of the cheapest order.
"""

from __future__ import annotations

import atexit
import dataclasses
import shutil
import tempfile
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, FixedPolicy
from hrl_escape.agents.making import make_agent, read_structure
from hrl_escape.agents.registry import SMDP_PREFIX
from hrl_escape.agents.spec import ORACLE, REFERENCES, AgentSpec
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.agents.training.env_description import make_described_env, name_part
from hrl_escape.agents.training.run import refusing_damage
from hrl_escape.agents.training.run_folder import read_run
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.agent_env import make_agent_env, make_player
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.pretrained import list_pretrained, unpack_pretrained
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import FileReadError, RunMismatchError, UnknownNameError, UnsupportedError
from hrl_escape.options.meta_actions import PlannedOption, list_goals, make_meta_options
from hrl_escape.options.option import Option
from hrl_escape.options.option_sets import DEFAULT_SET
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, Goal
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.route import Route, get_pose
from hrl_escape.sets.instance_set import InstanceSetEnv
from hrl_escape.sets.room_schedule import RoomSchedule
from hrl_escape.text.text_env import TextEnv

ROOMS = frozenset(map(name_part, (EscapeRoomEnv, EscapeRoomContinuousEnv, InstanceSetEnv)))
"""Innermost environments of runs that can be shown."""


class EscapePlan:
    """Legs of the planner's escapes, by the initial state of each."""

    def __init__(self, planner: RoomPlanner) -> None:
        self.planner = planner
        dynamics = planner.instance.dynamics
        self._foresees = dynamics.kind == "kinematic" and not dynamics.is_random
        self._legs: dict[Hashable, tuple[Goal, tuple[int, ...]]] = {}

    def find(self, state: RoomState) -> tuple[Goal, tuple[int, ...]] | None:
        """Return goal and primitives of the leg that begins in a state, from earlier plans, or None without one."""
        return self._legs.get((get_pose(state), state.puzzle))

    def choose(self, state: RoomState) -> Goal:
        """Return the next goal from a state, from a plan of the whole escape if that is predictable."""
        if self.find(state) is None and self._foresees:
            self._plan(state)
        leg = self.find(state)
        return self.planner.order_goals(state)[0] if leg is None else leg[0]

    def _plan(self, state: RoomState) -> None:
        try:
            plan = self.planner.solve(state)
        except UnsupportedError:  # escapes with pushes are not predictable
            self._foresees = False
            return
        for part in plan.parts:
            begin = plan.states[part.start]
            self._legs[get_pose(begin), begin.puzzle] = part.goal, tuple(plan.primitives[part.start : part.stop])


class _Leg(PlannedOption):
    """A planned option that follows the leg of an escape if one begins here, and plans for itself otherwise."""

    def __init__(self, name: str, plan: EscapePlan, goal: Goal) -> None:
        super().__init__(name, plan.planner, goal)
        self._escape = plan

    def _find_route(self, state: RoomState) -> Route:
        leg = self._escape.find(state)
        route = None
        if leg is not None and leg[0] == self.goal:
            route = self._planner.routes.replay(state, leg[1], self.goal)
        return route or super()._find_route(state)


def make_legs(plan: EscapePlan) -> tuple[Option, ...]:
    """Make the room's meta-actions, which follow a plan of the whole escape in states where its legs begin."""
    made = list(make_meta_options(plan.planner.instance, "press", plan.planner))
    for number, option in enumerate(made):
        if type(option) is PlannedOption:
            made[number] = _Leg(option.name, plan, option.goal)
            made[number].about = option.about
    return tuple(made)


class PlannerAgent(FixedPolicy):
    """Agent that chooses the legs of a plan, in an `OptionsEnv` over these legs without primitives."""

    def __init__(self, env: gymnasium.Env, plan: EscapePlan) -> None:
        self._room: Any = env.unwrapped
        self._plan = plan
        self._goals = [*list_goals(plan.planner.instance), ExitGoal()]

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the leg of the plan that begins here. Raises `PlanningFailed` if no order leads out."""
        del observation, action_mask
        return self._goals.index(self._plan.choose(self._room.get_state()))


@dataclasses.dataclass(frozen=True)
class Driver:
    """An agent and its environment."""

    name: str  # display name
    agent: Agent  # the agent
    env: gymnasium.Env  # its environment
    recorder: StateRecorder  # wrapper inside `env`, directly around the flat room
    names: tuple[str, ...]  # names of the actions
    primitives: int  # number of primitives, which are the first actions
    option_set: str  # named option set
    trains: bool = False  # whether the agent learns while it drives
    plan: EscapePlan | None = None  # plan of the oracle, or None for other drivers
    text_env: TextEnv | None = None  # environment inside `env` with the transcript, for agents that call tools

    @property
    def room(self) -> EscapeRoomEnv:
        """The room under all wrappers, with the current state."""
        room: Any = self.env.unwrapped
        return room

    def make_options(self) -> tuple[Option, ...]:
        """Make meta-actions like the environment's, for previews that do not disturb a running one."""
        instance = self.room.instance
        if self.plan is not None:
            return make_legs(self.plan)
        return make_meta_options(instance, self.option_set, get_planner(instance))


def open_driver(agent: str | AgentSpec | type[Agent], instance: RoomInstance, *, observation: str | None = None,
                seed: int = 0, trust: bool = False) -> Driver:
    """Open a driver by name: a reference such as `oracle`, the folder of a run, or an agent to train.

    `observation` and `seed` apply to an agent to train; the observation defaults to the one that it needs. A run stores
    its own. With `trust` a run's environment may import any code that its folder names.

    Raises:
        UnknownNameError: the name is neither a folder nor an agent, or a part of a spec is unknown.
        AgentSettingsError: the spec contradicts itself.
        FileReadError: the folder does not contain a run.
        CheckpointError: the run is damaged.
        TrustError: the run needs code from elsewhere, and `trust` is false.
        RunMismatchError: the run was made in a room with other spaces.
        UnsupportedError: this agent has no hierarchy for the room.
    """
    if isinstance(agent, str) and names_run(agent):
        return _open_run(Path(agent), instance, trust)
    spec = parse_driver(agent) if isinstance(agent, str) else AgentSpec.parse(agent)
    name, option_set = spec.name, spec.options.option_set
    observation = observation or spec.default_observation
    if name == ORACLE:
        recorder, plan = _make_room(instance, observation), EscapePlan(get_planner(instance))
        env = OptionsEnv(recorder, options=lambda _: make_legs(plan), include_primitives=False)
        return _make_driver("the oracle", PlannerAgent(env, plan), env, "press", plan=plan)
    env, recorder = make_agent_env(spec, instance, observation)
    if spec.is_reference:
        words = f"{name}, {spec.resolve_settings()['model']}" if name == TEXT_AGENT else name
        return _make_driver(words, make_player(spec, env, recorder), env, option_set)
    learner = make_agent(spec, env.observation_space, env.action_space, seed, read_structure(env))
    return _make_driver(f"{spec.label}, learning", learner, env, option_set, trains=True)


def find_driver(text: str) -> tuple[str, RoomInstance | None]:
    """Return a driver for `open_driver`, and its own room, or None if it has no room, or many.

    If `text` names a rung with a pretrained agent, such as `lattice`, that agent is unpacked until the process ends,
    and the room is the rung's first test room.
    """
    rung = next((rung for rung in list_pretrained() if text in (rung, rung.rpartition("/")[2])), None)
    if rung is None or (Path(text) / "run.json").is_file():
        return text, find_run_room(text)
    folder = tempfile.mkdtemp(prefix="hrl_escape-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    run, room = unpack_pretrained(rung, Path(folder))
    return str(run), room


def find_run_room(text: str) -> RoomInstance | None:
    """Return the room of a run, or None if `text` is not a run, or the run has many rooms."""
    if text == ORACLE or not (Path(text) / "run.json").is_file():
        return None
    described = read_run(text)
    with refusing_damage(f"{text}: the description of this run"):
        room = (described["environment"]["arguments"] or {}).get("instance")
        return RoomInstance.from_dict(room["content"]) if room else None


def _open_run(folder: Path, instance: RoomInstance, trust: bool) -> Driver:
    if not folder.is_dir():
        raise FileReadError(f"{folder}: no such run. `hrl-escape train` writes runs to runs/")
    described = read_run(folder)
    with refusing_damage(f"{folder}: the description of this run"):
        name, spaces = described["name"], (described["observation_space"], described["action_space"])
        kept = described["environment"]
        is_room = kept["class"] in ROOMS
    if not is_room:
        raise UnsupportedError(f"{folder} was trained in {kept['class']}, and only rooms can be shown. In Python, "
                               "evaluate(load_agent(folder), load_env(folder)) plays episodes")
    with refusing_damage(f"{folder}: the description of this run"):
        option_set = next((part["arguments"]["option_set"] for part in kept["wrappers"]
                           if "option_set" in part["arguments"]), DEFAULT_SET)
        arguments = kept["arguments"] or {}
        room = _make_room(instance, arguments.get("observation", "features"))
        kept = {**kept, "arguments": arguments | room.unwrapped.describe()}
        room.close()
        if kept["class"] == name_part(InstanceSetEnv):  # the room replaces the whole set, which needs no schedule
            wrappers = [part for part in kept["wrappers"] if part["class"] != name_part(RoomSchedule)]
            own = {name: value for name, value in kept["arguments"].items() if name != "rooms"}
            kept |= {"class": name_part(EscapeRoomEnv), "arguments": own, "wrappers": wrappers}
    env = make_described_env(kept, StateRecorder, trust=trust)
    if (repr(env.observation_space), repr(env.action_space)) != spaces:
        env.close()
        raise RunMismatchError(f"{folder} was trained with the spaces {spaces[0]} and {spaces[1]}, which room "
                               f"{instance.id} does not have: leave out --room to use the run's own room")
    return _make_driver(f"{name}, as trained", load_agent(folder, env), env, option_set)


def names_run(text: str) -> bool:
    """Return whether the name of a driver is the folder of a run."""
    return text not in REFERENCES and (Path(text).exists() or "/" in text)


def parse_driver(text: str) -> AgentSpec:
    """Return the spec of an agent or a reference. Raises `UnknownNameError` for other names."""
    try:
        return AgentSpec.parse(text)
    except UnknownNameError as error:
        note = f"; or the folder of a run. Each agent also has {SMDP_PREFIX} in front"
        raise UnknownNameError("driver", error.name, error.known, note) from None


def _make_room(instance: RoomInstance, observation: str) -> Any:
    return StateRecorder(EscapeRoomEnv(instance=instance, observation=observation))


def _make_driver(name: str, agent: Agent, env: gymnasium.Env, option_set: str, trains: bool = False,
                 plan: EscapePlan | None = None) -> Driver:
    room: Any = env.unwrapped
    flat = room.rules.actions.names
    names = env.get_wrapper_attr("action_names") if env.has_wrapper_attr("action_names") else flat
    primitives, text_env = sum(name in flat for name in names), env if isinstance(env, TextEnv) else None
    return Driver(name, agent, env, find_recorder(env), names, primitives, option_set, trains, plan, text_env)
