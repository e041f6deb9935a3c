"""The registry of observations: one class, and everything that offers observations knows it."""

import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from hrl_escape.env.config import ButtonsConfig, RoomConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import (
    get_observation,
    list_observations,
    make_observer,
    observations,
    register_observation,
)
from hrl_escape.env.observations.state import StateObserver
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.torchrl_env import EscapeRoomTorchRLEnv
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from tests.forks import run_fork

COMPASS = """
import numpy as np
from hrl_escape.env.observations.base import Observer, register_observation


class Compass(Observer):
    name, doc = "planted-compass", "sine and cosine of the heading"
    names = ("sin-heading", "cos-heading")
    low, high = -np.ones(2, np.float32), np.ones(2, np.float32)

    def observe(self, state):
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        return np.array((sin, cos), np.float32)

    @staticmethod
    def observe_batch(rooms):
        import torch

        cos, sin = rooms.rotation
        return [torch.stack([sin, cos]).to(torch.float32)]


register_observation(Compass)
"""


@pytest.fixture
def compass(tmp_path, monkeypatch):
    (tmp_path / "planted_compass.py").write_text(COMPASS)
    monkeypatch.syspath_prepend(tmp_path)
    import planted_compass

    yield planted_compass.Compass
    observations.unregister("compass")
    sys.modules.pop("planted_compass")


def test_one_entry_shows_an_observation_in_every_environment(compass):
    env = gymnasium.make("hrl_escape/PaperTwoButton-v1", observation="planted-compass")
    rooms = EscapeRoomVectorEnv(3, "paper-two-button", observation="planted-compass")
    tensors = EscapeRoomTorchRLEnv(3, "paper-two-button", observation="planted-compass")
    first, _ = env.reset(seed=0)
    assert env.observation_space.shape == (2,) and env.observation_space.contains(first)
    rooms.reset(seed=0)
    tensors.reset()
    for action in (4, 4, 0, 5):
        seen = env.step(action)[0]
        batch = rooms.step(np.full(3, action))[0]
        assert np.allclose(batch, seen, atol=1e-6)
    assert np.allclose(seen, (np.sin(np.radians(10)), np.cos(np.radians(10))), atol=1e-6)
    assert rooms.single_observation_space.shape == (2,)
    assert tensors.observation_spec["observation"].shape == (3, 2)


@pytest.mark.nightly
def test_one_entry_is_offered_by_the_command_line_and_accepted_by_grids(tmp_path):
    """A package that is installed with an entry point, as a stranger's is."""
    (tmp_path / "planted_compass.py").write_text(COMPASS)
    info = tmp_path / "planted-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: planted\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hrl_escape.observations]\nplanted-compass = planted_compass:Compass\n")
    script = (
        "from hrl_escape.cli import main\n"
        "main(['list', 'observations'])\n"
        "from hrl_escape.benchmark.presets import GRIDS\n"
        "import dataclasses\n"
        "print(dataclasses.replace(GRIDS['quickstart'], observation='planted-compass').observation, 'in a grid')\n"
        "main(['train', '--help'])\n"
    )
    done = run_fork(script, environment=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])})
    assert "sine and cosine of the heading" in done.stdout and "planted-compass in a grid" in done.stdout, done.stderr
    assert ",planted-compass}" in done.stdout.replace("\n", "").replace(" ", "").replace("\u2502", "")


def test_the_registry_refuses_a_taken_name_and_names_the_closest():
    with pytest.raises(ConfigError, match="no other observation"):
        register_observation(type("Another", (StateObserver,), {}))
    with pytest.raises(UnknownNameError, match="features"):
        get_observation("feature")


def test_bounds_have_the_shape_and_type_of_what_is_observed():
    rules = Kinematics(generate(get_preset("arm-two-button"), 0))
    state = rules.make_state(rules.instance.starts[0])
    for observation in list_observations():
        if not observation.is_vector:
            with pytest.raises(UnsupportedError, match="renderer"):
                make_observer(observation.name, rules)
            continue
        observer = make_observer(observation.name, rules)
        seen = observer.observe(state)
        assert seen.shape == observer.low.shape == observer.high.shape == (len(observer.names),)
        assert seen.dtype == observer.low.dtype and (observer.low <= seen).all() and (seen <= observer.high).all()


@pytest.mark.nightly
def test_the_registry_loads_no_torch_and_no_engine():
    script = ("import sys, hrl_escape.env.observations, hrl_escape.env.observations.base, hrl_escape.env.engine\n"
              "print([name for name in ('torch', 'pybullet', 'matplotlib') if name in sys.modules])")
    assert subprocess.check_output([sys.executable, "-c", script], text=True).strip() == "[]"


def test_an_observation_without_a_tensor_function_is_refused_by_the_batched_engine():
    with pytest.raises(UnsupportedError, match="pixels"):
        EscapeRoomVectorEnv(2, "paper-two-button", observation="pixels")


def test_what_an_observer_remembers_of_a_puzzle_is_bounded():
    room = generate(RoomConfig(puzzle=ButtonsConfig(count=13)), 0)
    rules = Kinematics(room)
    observer = make_observer("features", rules)
    state = rules.make_state(room.starts[0])
    for puzzle in range(5_000):
        seen = observer.observe(state._replace(puzzle=puzzle))
        assert seen[-13:].tolist() == [float(puzzle >> button & 1) for button in range(13)]
    assert 0 < len(observer._seen) <= 4_097
