"""Protocols of the ladder: grids of a rung, and the judgement of an agent."""

import dataclasses

import pytest

from benchmarks.ladder import find_miscalibration, find_steps
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.protocols import LadderSettings, Protocol, make_protocol_grid
from hrl_escape.benchmark.standings import judge, list_standings
from hrl_escape.benchmark.summary import summarise
from hrl_escape.errors import ConfigError, GridError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.room_spec import RoomSpec
from tests.benchmark.made_up import compare

BENCH = load_benchmark("ladder-1")
AGENTS = (AgentSpec("smdp-dqn"), AgentSpec("oracle"))


def test_per_instance_learns_each_of_ten_test_rooms_from_nothing():
    grid = make_protocol_grid(BENCH, "pair", "per-instance", AGENTS, LadderSettings())
    assert len(grid.rooms) == 10 and grid.runs == 10 and grid.primitives == 20_000 and grid.eval_episodes == 20
    assert grid.rooms[3].make_instance() == BENCH["pair"].test[3]
    assert make_protocol_grid(BENCH, "lattice", "per-instance", AGENTS, LadderSettings()).primitives == 100_000
    assert make_protocol_grid(BENCH, "house", "per-instance", AGENTS, LadderSettings()).primitives == 500_000


def test_per_instance_shows_features_unless_an_agent_reads_objects():
    def find_observation(*agents: str, protocol: Protocol = "per-instance", observation: str | None = None) -> str:
        settings, specs = LadderSettings(observation=observation), tuple(map(AgentSpec.parse, agents))
        return make_protocol_grid(BENCH, "lattice", protocol, specs, settings).observation

    assert find_observation("smdp-factored-r-max", "oracle") == "features"
    assert find_observation("smdp-dqn+objects", "oracle") == find_observation("smdp-dqn+memory") == "objects"
    assert find_observation("smdp-dqn", protocol="generalise") == "objects"
    assert find_observation("smdp-dqn", observation="state") == "state"


@pytest.mark.nightly
def test_factored_r_max_plans_over_what_the_largest_lattice_shows():
    spec = AgentSpec.parse("smdp-factored-r-max")
    grid = make_protocol_grid(BENCH, "lattice", "per-instance", (spec,), LadderSettings(rooms=1))
    env, _ = make_agent_env(spec, grid.rooms[0].make_instance(), grid.observation)
    result = train(spec.name, env, primitives=60, seed=0, eval_every=60, eval_episodes=1, progress=False)
    assert result.decisions > 2, "it planned, where rows of objects have more bits than it plans over"
    env.close()


def test_generalise_trains_in_sets_of_training_rooms_and_is_tested_once_in_every_test_room():
    grid = make_protocol_grid(BENCH, "doormat", "generalise", AGENTS, LadderSettings(train_sizes=(1, 16)))
    assert grid.eval_episodes == BENCH["doormat"].record.test.count and not grid.rooms
    places = grid.make_places()
    assert [len(place.split.train) for place in places] == [1, 16]
    assert all(list(place.split.test.seeds) == list(BENCH["doormat"].test.seeds) for place in places)
    assert all(place.split.room_overlap == 0 for place in places)


def test_transfer_trains_on_one_rung_and_is_tested_on_another():
    agents = (AgentSpec.parse("smdp-dqn+objects"), AgentSpec("oracle"))
    settings = LadderSettings(source="chain", rooms=5, train_sizes=(16,))
    grid = make_protocol_grid(BENCH, "lattice-5", "transfer", agents, settings)
    (place,) = grid.make_places()
    assert place.split.train.config == BENCH["chain"].config and len(place.split.train) == 16
    assert list(place.split.test.seeds) == list(BENCH["lattice-5"].test.seeds[:5]) and place.split.is_transfer
    assert grid.primitives == 20_000, "the budget of chain"
    assert place.split.room_overlap == 0


def test_few_shot_is_generalise_with_several_trials_in_each_room():
    grid = make_protocol_grid(BENCH, "pair", "few-shot", AGENTS, LadderSettings(rooms=4, trials=3))
    plain = make_protocol_grid(BENCH, "pair", "generalise", AGENTS, LadderSettings(rooms=4))
    assert grid.trials == 3 and plain.trials == 1
    assert dataclasses.replace(grid, trials=1, name=plain.name) == plain
    keys = [{run.key for run in each.make_runs(each.make_places())} for each in (grid, plain)]
    assert not keys[0] & keys[1], "runs with trials are others than those without"
    with pytest.raises(ConfigError, match="2 or more"):
        make_protocol_grid(BENCH, "pair", "few-shot", AGENTS, LadderSettings(trials=1))
    with pytest.raises(GridError, match="trials"):
        Grid(rooms=(RoomSpec("clutter"),), trials=2)


@pytest.mark.parametrize(("protocol", "source", "words"), [
    ("transfer", None, "the rung to train on"), ("generalise", "chain", "with no other"),
    ("transfer", "pair", "another rung than pair"),
])
def test_a_rung_to_train_on_goes_with_transfer_and_nothing_else(protocol, source, words):
    with pytest.raises(ConfigError, match=words):
        make_protocol_grid(BENCH, "pair", protocol, AGENTS, LadderSettings(source=source))


@pytest.mark.parametrize(("rung", "changes", "error", "words"), [
    ("latice", {}, UnknownNameError, "did you mean 'lattice'"),
    ("pair", {"rooms": 101}, ConfigError, "from 1 to 100"),
    ("pair", {"train_sizes": (1001,)}, ConfigError, "from 1 to 1000"),
])
def test_what_a_rung_has_not_is_refused(rung, changes, error, words):
    with pytest.raises(error, match=words):
        make_protocol_grid(BENCH, rung, "generalise", AGENTS, LadderSettings(**changes))


@pytest.mark.nightly
def test_a_rung_is_passed_with_sure_escapes_and_half_the_efficiency():
    good, poor = [90.0] * 4, [-1000.0] * 4
    summary = summarise(compare({"dqn": [good] * 40, "sarsa": [poor] * 40}))
    passed = {standing.agent.label: standing for standing in list_standings("pair", summary)}
    assert not passed["sarsa"].is_passed and passed["sarsa"].success_rate[0] == 0
    agent = passed["dqn"].agent
    (share, low, high), is_passed = judge(agent, 40)
    assert share == 1.0 and low == pytest.approx(40 / (40 + 1.959964**2), abs=1e-6), "Wilson 1927, all of n"
    assert is_passed == (agent.efficiency.value >= 0.5) == (low >= 0.9 and agent.efficiency.value >= 0.5)
    assert not judge(agent, 30)[1], "30 of 30 leave the share unsure"


def test_a_rung_is_calibrated_where_chance_fails_and_the_planner_does_not():
    assert not find_miscalibration(0.49, 1.0)
    assert find_miscalibration(0.5, 1.0) == ["chance reaches 0.50, not below 0.5"]
    assert len(find_miscalibration(0.6, 0.9)) == 2
    assert find_miscalibration(0.4, 0.96) == ["the planner reaches 0.96, not 1"]
    assert not find_miscalibration(0.4, 0.96, is_stochastic=True), "its expectation, from which six episodes stray"


def test_a_rung_where_a_learner_falls_from_mastery_to_nothing_is_a_step():
    rows = {"low": {"a": 0.95, "b": 0.95, "chance": 0.95}, "middle": {"a": 0.05, "b": 0.5, "chance": 0.0},
            "high": {"a": 0.9, "b": 0.05, "chance": 0.0}, "top": {"a": 0.0, "b": 0.0, "chance": 0.0}}
    assert find_steps(rows, ["a", "b"]) == {
        "low": [], "middle": ["a falls from 0.95 on low to 0.05"], "high": [], "top": []}
