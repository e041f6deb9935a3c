"""Pretrained agents: each plays its rooms again to the published results, from plain arrays of a few kB."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.leaderboard.page import RESULTS
from benchmarks.leaderboard.results import load
from benchmarks.pretrained import LEARNED
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.benchmark.pretrained import list_pretrained, load_pretrained
from hrl_escape.errors import UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.viewer.watch.drivers import ORACLE, find_driver, open_driver
from tests.covering import thin

load_once = cache(load_pretrained)
"""For tests that only look at what they load, or play from its file."""
AGENTS = [(rung, agent) for rung, agents in list_pretrained().items() for agent in agents]


@pytest.mark.nightly_for(
    "ladder-1/chain-smdp-factored-r-max", "ladder-1/chain-3-smdp-ppo+objects+memory",
    "ladder-1/chain-3-smdp-q-learning", "ladder-1/clutter-smdp-factored-r-max",
    "ladder-1/code-smdp-r-max", "ladder-1/house-smdp-factored-r-max@three-parents",
    "ladder-1/lattice-smdp-factored-r-max", "ladder-1/lattice-7-smdp-factored-r-max",
    "ladder-1/lattice-8-smdp-factored-r-max@three-parents",
    "ladder-1/reach-smdp-factored-r-max", "ladder-1/chain-4-smdp-factored-r-max",
    "ladder-1/doors-smdp-q-learning", "ladder-1/freight-smdp-r-max",
    "ladder-1/lattice-5-smdp-factored-r-max", "ladder-1/lattice-6-smdp-factored-r-max",
    "ladder-1/switchboard-smdp-r-max", "ladder-1/drift-smdp-factored-r-max")
@pytest.mark.parametrize(("rung", "agent"), AGENTS)
def test_a_pretrained_agent_plays_its_rooms_to_the_published_results(rung, agent):
    found = load_once(rung, agent)
    assert all(each.is_equal for each in found.verify(min(3, len(found.results)), seed=0))
    assert found.result.evaluations[-1].primitives == found.result.primitives == found.card.primitives
    assert found.score.low <= found.score.value <= found.score.high and agent in found.card.training
    env = found.make_env()
    observation, info = env.reset(seed=0)
    assert env.action_space.contains(found.agent.act_greedy(observation, info["action_mask"].astype(bool),
                                                              np.random.default_rng(0)))
    env.close()


@pytest.mark.parametrize("name", ["chain-3", *thin([name for name in LEARNED if name != "chain-3"], 5)])
def test_a_pretrained_agent_drives_in_the_first_test_room_of_its_rung(name: str):
    """The agent of `chain-3` was trained in a set of rooms."""
    folder, room = find_driver(name)
    benchmark, _, rung = name.rpartition("/")
    assert room is not None and room.digest == load_benchmark(benchmark or "ladder-1")[rung].test[0].digest
    driver = open_driver(folder, room)
    played = evaluate(driver.agent, driver.env, 1)
    driver.env.close()
    assert played.successes == (True,) and played.lengths[0] < room.horizon / 5


def test_whatever_names_no_rung_is_its_own_driver(tmp_path: Path):
    assert find_driver(ORACLE) == (ORACLE, None) and find_driver("smdp-dqn") == ("smdp-dqn", None)
    assert find_driver("sequence") == ("sequence", None), "no agent comes for it"


@pytest.mark.nightly
def test_there_are_pretrained_agents_they_are_small_and_listed_on_the_leaderboard():
    assert {rung.name for rung in load_benchmark("ladder-1")} == LEARNED.keys(), "one for every rung"
    assert {f"ladder-1/{name}" for name in LEARNED} <= list_pretrained().keys()
    listed = {(result.card.benchmark, result.card.rung, result.card.name): result.results
              for result in map(load, RESULTS.glob("*.json"))}
    sizes = 0
    for rung, agent in AGENTS:
        found = load_once(rung, agent)
        sizes += found.path.stat().st_size
        benchmark, _, name = rung.partition("/")
        if load_benchmark(benchmark)[name].record.test.count == found.card.rooms:
            assert listed[benchmark, name, agent] == found.results
    assert sizes < 4e6
    with pytest.raises(UnknownNameError, match="ladder-1/chain"):
        load_pretrained("ladder-1/chian")
    with pytest.raises(UnknownNameError, match="smdp-ppo"):
        load_pretrained("ladder-1/chain-3", "smdp-dqn")
