"""An algorithm, a puzzle and an observation, added as docs/architecture.md says, arrive everywhere with nothing else
touched: each test plants one in a copy of the package and finds it by name, checked, listed and trained."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A copy of the package in which anything may be planted."""
    shutil.copytree(ROOT / "hrl_escape", tmp_path / "hrl_escape", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def run(house: Path, *arguments: str) -> str:
    """Output of this Python in the copy."""
    environment = os.environ | {"PYTHONPATH": str(house), "NUMBA_CACHE_DIR": str(house / "numba")}
    done = subprocess.run([sys.executable, *arguments], cwd=house, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def call(house: Path, *arguments: str) -> str:
    """Output of `hrl-escape` in the copy."""
    return run(house, "-m", "hrl_escape.cli", *arguments)


ALGORITHM = '''
"""Always the first legal action."""

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.settings import AgentSettings

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


def test_a_file_in_algorithms_is_an_agent(house: Path):
    (house / "hrl_escape/agents/algorithms/first_legal.py").write_text(ALGORITHM)
    assert "first-legal" in call(house, "list", "agents")
    run(house, "-c", "from hrl_escape.agents.registry import get_agent_class as get\n"
                     "from hrl_escape.checks import check_agent\ncheck_agent(get('first-legal'))")
    out = call(house, "train", "smdp-first-legal", "--preset", "paper-one-button", "--primitives", "60",
               "--eval-episodes", "1", "--out", "planted", "--json")
    assert '"agent": "smdp-first-legal"' in out or (house / "planted/result.json").is_file()


def test_a_file_in_puzzles_is_a_puzzle(house: Path):
    source = (ROOT / "examples/smallest_puzzle.py").read_text()
    body, _, _ = source.partition("room = generate(")
    body = body.replace("from hrl_escape import RoomConfig, RoomPlanner, generate\n", "").replace(
        "from hrl_escape.env.kinematics import Kinematics\n", "")
    (house / "hrl_escape/env/puzzles/toggles.py").write_text(body)
    assert "toggles" in call(house, "list", "puzzles")
    run(house, "-c", "import numpy\nfrom hrl_escape.checks import check_puzzle\n"
                     "from hrl_escape.env.puzzles.base import get_puzzle_kind as get\n"
                     "check_puzzle(get('toggles').config_type().make_puzzle(numpy.random.default_rng(0)))")
    assert "press-a" in call(house, "solve", "--set", "puzzle.kind=toggles", "--seed", "1")


OBSERVATION = '''

class CompassObserver(Observer):
    """Sine and cosine of the heading, and nothing else."""

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        self.names = ("sin-heading", "cos-heading")
        self.high = np.ones(2, dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        heading = self._rules.get_heading(state)
        return np.array((math.sin(heading), math.cos(heading)), dtype=np.float32)


register_observation(Observation("compass", "the heading alone", CompassObserver))
'''


def test_an_entry_of_the_registry_is_an_observation(house: Path):
    with (house / "hrl_escape/env/observations.py").open("a") as file:
        file.write(OBSERVATION)
    assert "compass" in call(house, "list", "observations")
    assert "the heading alone" in call(house, "list", "observations", "--json")
    shape = run(house, "-c", "import gymnasium, hrl_escape\nfrom hrl_escape.env.escape_room import EscapeRoomEnv\n"
                             "env = EscapeRoomEnv('paper-one-button', observation='compass')\n"
                             "print(env.observation_space.shape, env.reset(seed=0)[0].tolist())")
    assert shape.startswith("(2,) [0.0, 1.0]")
    call(house, "train", "q-learning", "--preset", "paper-one-button", "--observation", "compass", "--primitives", "40",
         "--eval-episodes", "1", "--out", "planted")
    assert (house / "planted/result.json").is_file()
