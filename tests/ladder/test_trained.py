"""Trained agents that come with the package escape from the rooms that they were trained in, and are plain arrays."""

import json
import zipfile

import numpy as np
import pytest

from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import load_agent, load_env
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.trained import CHECKPOINT, find_trained_agent, list_trained_agents
from hrl_escape.viewer.watch.drivers import PLANNER_NAME, find_driver, find_run_room
from tests.covering import thin

RUNGS = list_trained_agents()


def test_rungs_have_trained_agents_and_lattice_is_one_of_them():
    assert set(RUNGS) <= {rung.name for rung in load_benchmark("ladder-1")}
    assert "lattice" in RUNGS and find_trained_agent("tower") is None
    assert find_driver(PLANNER_NAME) == PLANNER_NAME and find_driver("smdp-dqn") == "smdp-dqn"


@pytest.mark.parametrize("rung", thin(RUNGS, 6))
def test_a_trained_agent_escapes_from_the_first_test_room_of_its_rung(rung: str):
    folder = find_trained_agent(rung)
    assert folder is not None and str(folder) == find_driver(rung)
    room = find_run_room(str(folder))
    assert room is not None and room.digest == load_benchmark("ladder-1")[rung].test[0].digest
    env = load_env(folder)
    played = evaluate(load_agent(folder), env, 1)
    env.close()
    assert played.successes == (True,) and played.lengths[0] < room.horizon / 5


@pytest.mark.parametrize("rung", RUNGS)
def test_a_trained_agent_is_small_and_nothing_in_it_is_pickled(rung: str):
    folder = find_trained_agent(rung)
    assert folder is not None and {path.name for path in folder.iterdir()} == {"run.json", CHECKPOINT}
    assert (folder / CHECKPOINT).stat().st_size < 1_000_000
    json.loads((folder / "run.json").read_text())
    with np.load(folder / CHECKPOINT, allow_pickle=False) as arrays:
        assert all(arrays[name].dtype != object for name in arrays.files)
    with zipfile.ZipFile(folder / CHECKPOINT) as archive:
        assert all(name.endswith(".npy") for name in archive.namelist())
