"""Rooms, servers and one browser for the viewer's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hrl_escape.agents.training.train import train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.server import Server, open_server
from tests.viewer.browser import PROGRAM, Browser, open_browser


@pytest.fixture(scope="session")
def one_button() -> RoomInstance:
    return generate(get_preset("paper-one-button"), 0)


@pytest.fixture(scope="session")
def two_buttons() -> RoomInstance:
    return generate(get_preset("paper-two-button"), 0)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if PROGRAM is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")
    with open_browser() as browser:
        yield browser


@pytest.fixture
def server() -> Iterator[Server]:
    server = open_server(port=0)
    yield server
    server.stop()


@pytest.fixture(scope="session")
def clutter() -> RoomInstance:
    return generate(get_preset("clutter"), 3)


@pytest.fixture(scope="session")
def run(two_buttons, tmp_path_factory) -> Path:
    """A short training run of smdp-dqn, as `hrl-escape train` leaves it."""
    folder = tmp_path_factory.mktemp("run")
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    train("smdp-dqn+primitives", env, primitives=1500, seed=0, out=folder, eval_episodes=0, progress=False)
    return folder
