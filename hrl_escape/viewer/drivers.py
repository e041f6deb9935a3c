"""Who drives in watch mode: the planner, a trained run, or an agent that is being trained as one looks on.

Each becomes an agent, in an environment made as in training. Nothing here shows anything.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.registry import SMDP_PREFIX, get_agent_class, make_agent
from hrl_escape.agents.training import load_agent
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import CheckpointError, FileReadError, RunMismatchError
from hrl_escape.files import read_json
from hrl_escape.options.goals import ExitGoal
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.synthesis import list_goals
from hrl_escape.viewer.tap import Tap

__all__ = ["PLANNER", "Driver", "PlannerAgent", "find_room", "open_driver"]

PLANNER = "planner"
OBSERVATIONS = ("features", "state", "egocentric")


@dataclasses.dataclass(frozen=True)
class Driver:
    """Somebody at the wheel.

    Attributes:
        name: in words.
        agent: who decides.
        env: where it decides.
        tap: inside `env`, around the flat room.
        names: of the actions.
        primitives: how many of these are primitives; they come first.
        flavour: of the meta-actions.
        trains: it learns while it drives.
    """

    name: str
    agent: Agent
    env: gymnasium.Env
    tap: Tap
    names: tuple[str, ...]
    primitives: int
    flavour: str
    trains: bool = False

    @property
    def room(self) -> EscapeRoomEnv:
        """The flat room."""
        room: Any = self.env.unwrapped
        return room


def open_driver(text: str, instance: RoomInstance, *, observation: str = "features", flavour: str = "press",
                include_primitives: bool = True, recipe: str = "corrected", seed: int = 0,
                settings: Mapping[str, Any] | None = None) -> Driver:
    """Make a driver of what the user named.

    Args:
        text: `planner`, the folder of a run, or the name of an agent to be trained.
        instance: the room.
        observation: what an agent sees; for a run, what it saw in training is found out.
        flavour: of its meta-actions.
        include_primitives: whether an agent over options chooses among primitives too; found out for a run.
        recipe: of an agent to be trained.
        seed: of an agent to be trained.
        settings: fields of its settings to change.

    Raises:
        UnknownNameError: neither a folder nor an agent.
        FileReadError, CheckpointError: no run there, or a damaged one.
        RunMismatchError: the run was made in a room with other spaces.
    """
    if text == PLANNER:
        env, tap = _make_env(instance, observation, True, False, flavour, False)
        agent: Agent = PlannerAgent(env, get_planner(instance))
        return _make_driver("the planner", agent, env, tap, flavour)
    folder = Path(text)
    if folder.exists() or "/" in text:
        return _open_run(folder, instance, flavour)
    agent_class = get_agent_class(text)
    over_options = text.startswith(SMDP_PREFIX)
    trace = over_options and getattr(agent_class, "needs_trace", False)
    env, tap = _make_env(instance, observation, over_options, include_primitives, flavour, trace)
    agent = make_agent(text, env.observation_space, env.action_space, seed, recipe, **(settings or {}))
    return _make_driver(f"{text}, learning", agent, env, tap, flavour, trains=True)


def find_room(text: str) -> Path | None:
    """The room that is kept beside a run, if `text` names a run that has one."""
    path = Path(text) / "room.json"
    return path if text != PLANNER and path.is_file() else None


def _open_run(folder: Path, instance: RoomInstance, flavour: str) -> Driver:
    if not folder.is_dir():
        raise FileReadError(f"{folder}: no such run; hrl-escape train leaves one in runs/")
    described = read_json(folder / "run.json", "description of a run")
    try:
        name, spaces = described["name"], (described["observation_space"], described["action_space"])
    except (KeyError, TypeError):
        raise CheckpointError(f"{folder / 'run.json'}: this does not describe a run") from None
    over_options = name.startswith(SMDP_PREFIX)
    for observation, primitives in itertools.product(OBSERVATIONS, (True, False) if over_options else (True,)):
        env, tap = _make_env(instance, observation, over_options, primitives, flavour, False)
        if (repr(env.observation_space), repr(env.action_space)) == spaces:
            return _make_driver(f"{name}, as trained", load_agent(folder, env), env, tap, flavour)
        env.close()
    raise RunMismatchError(f"{folder} was trained with the spaces {spaces[0]} and {spaces[1]}, which room "
                           f"{instance.id} does not have: name its room with --load, or --preset and --seed")


def _make_env(instance: RoomInstance, observation: str, over_options: bool, primitives: bool, flavour: str,
              trace: bool) -> tuple[gymnasium.Env, Tap]:
    tap = Tap(EscapeRoomEnv(instance=instance, observation=observation))
    if not over_options:
        return tap, tap
    return OptionsEnv(tap, include_primitives=primitives, flavour=flavour, trace=trace), tap


def _make_driver(name: str, agent: Agent, env: gymnasium.Env, tap: Tap, flavour: str, trains: bool = False) -> Driver:
    room: Any = env.unwrapped
    flat = tuple(primitive.name for primitive in room.rules.primitives)
    names = env.action_names if isinstance(env, OptionsEnv) else flat
    primitives = sum(name in flat for name in names)
    return Driver(name, agent, env, tap, names, primitives, flavour, trains)


@dataclasses.dataclass(frozen=True)
class PlannerSettings:
    """The planner has none that matter here."""

    gamma: float = 0.99


class PlannerAgent:
    """Chooses the meta-action that the room's planner would do next; it learns nothing.

    Args:
        env: an `OptionsEnv` without primitives.
        planner: of the room.
    """

    Settings: ClassVar[type] = PlannerSettings

    def __init__(self, env: gymnasium.Env, planner: RoomPlanner) -> None:
        self.settings = PlannerSettings()
        self._room: Any = env.unwrapped
        self._planner = planner
        self._goals = [*list_goals(planner.instance), ExitGoal()]

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The first of what is left to do, in the cheapest order. Raises `PlanningFailed`."""
        del observation, action_mask
        return self._goals.index(self._planner.order_goals(self._room.get_state())[0])

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The same."""
        del rng
        return self.act(observation, action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Nothing to learn."""
        del transition
        return {}

    def state_dict(self) -> dict[str, Any]:
        """Nothing to keep."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Nothing to restore."""
