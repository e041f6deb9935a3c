"""An algorithm, a variant, a puzzle, an observation and a command option, added as docs/architecture.md says.

They are planted in a copy of the package and found by name, checked, listed and trained with nothing else touched."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.forks import run_fork

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a copy of the package, in which all are planted, prints in each act."""
    house = tmp_path_factory.mktemp("house")
    shutil.copytree(ROOT / "hrl_escape", house / "hrl_escape", ignore=shutil.ignore_patterns("__pycache__"))
    (house / "hrl_escape/agents/algorithms/first_legal.py").write_text(ALGORITHM)
    (house / "hrl_escape/agents/algorithms/mellow_dqn.py").write_text(VARIANT)
    (house / "hrl_escape/env/puzzles/toggles.py").write_text(read_puzzle())
    (house / "hrl_escape/env/observations/compass.py").write_text(OBSERVATION)
    command = house / "hrl_escape/commands/room.py"
    text = command.read_text()
    for place, line in OPTION.items():
        assert text.count(place) == 1, place
        text = text.replace(place, place + line)
    command.write_text(text)
    done = run_fork(ACTS, cwd=house, environment=os.environ | {"PYTHONPATH": str(house)})
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def read_puzzle() -> str:
    """The puzzle of an example, as a module of the package."""
    body, _, _ = (ROOT / "examples/smallest_puzzle.py").read_text().partition("room = generate(")
    return body.replace("from hrl_escape import RoomConfig, RoomPlanner, generate\n", "").replace(
        "from hrl_escape.env.kinematics import Kinematics\n", "")


ALGORITHM = '''
"""Always the first legal action."""

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.agent import AgentSettings

import dataclasses


@dataclasses.dataclass(frozen=True)
class FirstSettings(AgentSettings):
    """Settings of `first-legal`."""

    gamma: float = 0.99
    """Discount per primitive."""


class FirstLegal(Agent):
    """The first legal action, whatever is seen."""

    Settings = FirstSettings

    def __init__(self, observation_space, action_space, seed, settings=None):
        self.settings = settings or FirstSettings()

    def act(self, observation, action_mask):
        return int(action_mask.argmax())

    def act_greedy(self, observation, action_mask, rng):
        return int(action_mask.argmax())

    def observe(self, transition):
        return {}

    def state_dict(self):
        return {}

    def load_state_dict(self, state):
        pass
'''


VARIANT = (ROOT / "examples/extend/mellow_dqn.py").read_text()


OPTION = {
    "    json: bool = False\n    \"\"\"Print JSON instead of a table.\"\"\"\n":
    "    shout: bool = False\n    \"\"\"Print the name of the room in capitals.\"\"\"\n",
    "    instance = args.make_instance()\n":
    "    if args.shout:\n        print(instance.name.upper())\n",
}
"""Place in `commands/room.py` -> lines of a new option that follow it."""


OBSERVATION = (ROOT / "examples/extend/compass.py").read_text() + """
from hrl_escape.env.observations.base import register_observation

register_observation(Compass)
"""

ACTS = '''
import contextlib, io, json
import gymnasium, numpy
from hrl_escape.agents import train
from hrl_escape.agents.registry import get_agent_class, list_recipes
from hrl_escape.checks import check_agent, check_puzzle
from hrl_escape.cli import main
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.env.puzzles.base import get_puzzle_kind

said = {}


def call(*arguments):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(list(arguments)) == 0, arguments
    said[" ".join(arguments[:2])] = out.getvalue()


for things in "agents", "puzzles", "observations":
    call("list", things)
check_agent(get_agent_class("first-legal"))
check_puzzle(get_puzzle_kind("toggles").config_type().make_puzzle(numpy.random.default_rng(0)))
budget = ["--room", "paper-one-button", "--primitives", "40", "--eval-episodes", "1", "--json"]
call("train", "smdp-first-legal", *budget, "--out", "algorithm")
call("train", "q-learning", *budget, "--observation", "compass", "--out", "observation")
small = {"warmup": 20, "hidden": (8,), "batch_size": 8}
for name, many in (("one", EscapeRoomEnv("paper-one-button", observation="features")),
                   ("many", EscapeRoomVectorEnv(4, "paper-one-button", observation="features"))):
    done = train("mellow-dqn", many, primitives=120, settings=small, eval_episodes=1)
    said[name] = [done.primitives, done.agent.settings.n_step, done.agent.values.learner.updates,
                  len(list_recipes("smdp-mellow-dqn")["default"].to_dict())]
call("room", "--shout", "--room", "paper-one-button")
call("solve", "--set", "puzzle.kind=toggles", "--room", "custom#1")
env = EscapeRoomEnv("paper-one-button", observation="compass")
said["first"] = [env.observation_space.shape, env.reset(seed=0)[0].tolist()]
batch = EscapeRoomVectorEnv(2, "paper-one-button", observation="compass")
said["batch"] = batch.reset(seed=0)[0].tolist()
toggled = EscapeRoomVectorEnv(2, {"puzzle": {"kind": "toggles"}}, num_instances=2)
toggled.reset(seed=0)
said["toggled"] = toggled.step(numpy.zeros(2, dtype=int))[0].shape
print(json.dumps(said))
'''


def test_a_file_in_algorithms_is_an_agent(said):
    assert "first-legal" in said["list agents"]
    assert json.loads(said["train smdp-first-legal"])["primitives"] >= 40


def test_a_variant_of_dqn_is_under_30_lines_and_keeps_its_streams_n_step_and_settings(said):
    assert VARIANT.strip().count("\n") <= 30
    assert "mellow-dqn" in said["list agents"]
    for where in "one", "many":
        primitives, n_step, updates, settings = said[where]
        assert primitives >= 120 and n_step == 3 and updates > 10 and settings > 30


def test_a_file_in_puzzles_is_a_puzzle_of_one_room_and_of_a_batch(said):
    assert "toggles" in said["list puzzles"]
    assert "press-a" in said["solve --set"]
    assert said["toggled"][0] == 2, "a batch of two rooms of it"


def test_a_file_in_observations_is_an_observation_of_one_room_and_of_a_batch(said):
    assert "compass" in said["list observations"] and "sine and cosine" in said["list observations"]
    assert json.loads(said["train q-learning"])["primitives"] >= 40
    assert said["first"] == [[2], [0.0, 1.0]] and said["batch"] == [[0.0, 1.0]] * 2


def test_a_field_of_a_dataclass_is_an_option_of_a_command(said):
    assert said["room --shout"].startswith("PAPER-ONE-BUTTON")
    assert sum(lines.count("\n") for lines in OPTION.values()) == 4
