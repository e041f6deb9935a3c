"""Training from data sets: run folders, resuming, evaluations, and what does not fit is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hrl_escape.agents.algorithms.offline.hiql import cut_everywhere
from hrl_escape.agents.components.offline import FEW_DECISIONS
from hrl_escape.agents.registry import get_agent_class, list_agents, list_offline_agents
from hrl_escape.agents.training.train import load_agent, train
from hrl_escape.data.materialise import load_data
from hrl_escape.errors import AgentSettingsError, UnsupportedError
from tests.covering import thin
from tests.data.small import make_recording, save_small

NETWORKS = {"values": "network", "hidden": [8], "batch_size": 16}
SMALL = {"decision-transformer": {**NETWORKS, "width": 4, "layers": 1}}


def list_names():
    return [name if get_agent_class(name).reads_both else f"smdp-{name}" for name in list_offline_agents()]


@pytest.mark.nightly_for("hiql", "smdp-cql")
@pytest.mark.parametrize("name", thin(list_names(), step=3, first=1))
def test_each_agent_learns_goes_on_to_the_same_bits_and_is_loaded_from_its_folder(name, tmp_path, monkeypatch):
    settings = SMALL.get(name.removeprefix("smdp-"), NETWORKS)
    data = load_data(make_recording(), observation="objects", rooms="own")
    arguments = {"data": data, "settings": settings, "eval_every": 2_000, "eval_episodes": 1}
    whole = train(name, **arguments, primitives=6_000)
    assert whole.primitives >= 6_000 and whole.segments and len(whole.evaluations) > 2
    env = data.make_env(name.startswith("smdp-"), 0.99)
    reset, count = env.reset, [0]

    def reset_or_stop(**given):
        count[0] += 1
        if count[0] == 3:  # the evaluation before training, one amid it, and this one
            raise KeyboardInterrupt
        return reset(**given)

    monkeypatch.setattr(env, "reset", reset_or_stop)
    with pytest.raises(KeyboardInterrupt):
        train(name, env, **arguments, primitives=6_000, out=tmp_path / "run", checkpoint_seconds=0)
    again = train(name, **arguments, primitives=6_000, out=tmp_path / "run", checkpoint_seconds=0)
    assert again.evaluations == whole.evaluations
    loaded = load_agent(tmp_path / "run")
    observation = data.read_decisions(0.99).observation[0]
    np.testing.assert_array_equal(loaded.compute_preferences(observation),
                                  whole.agent.compute_preferences(observation))


@pytest.mark.nightly_for("smdp-sharsa", "smdp-behaviour-cloning", "smdp-cql", "smdp-iql")
@pytest.mark.parametrize("name", ["smdp-behaviour-cloning", "smdp-fitted-q", "smdp-cql", "smdp-iql", "smdp-sharsa"])
def test_tables_end_when_a_sweep_changes_nothing_and_come_back_from_their_folder(name, tmp_path):
    data = load_data(make_recording(), observation="features", rooms="own")
    result = train(name, data=data, settings={"values": "table"}, eval_episodes=2, out=tmp_path / "run")
    assert result.agent.is_table
    loaded = load_agent(tmp_path / "run")
    assert np.array_equal(loaded.scores, result.agent.scores) and np.array_equal(loaded.q, result.agent.q)
    assert train(name, data=data, settings={"values": "table"}, eval_episodes=2, out=tmp_path / "run"
                 ).evaluations == result.evaluations


@pytest.mark.nightly
def test_a_clone_of_experts_escapes_where_the_clone_of_random_play_does_not():
    rates = {}
    for kind in ("expert", "play"):
        data = load_data(make_recording(kind), observation="features", rooms="own")
        result = train("smdp-behaviour-cloning", data=data, settings={"values": "table"}, eval_episodes=6)
        rates[kind] = result.evaluations[-1].success_rate
    assert rates["expert"] == 1.0 > rates["play"]


def test_networks_on_little_data_are_warned_of_with_the_setting_that_suits_it(recwarn):
    data = load_data(make_recording(), observation="features", rooms="own")
    assert len(data.read_decisions(0.9).action) < FEW_DECISIONS
    message = r"fitted-q fits networks to \d+ decisions\..*\{'values': 'table'\}"
    with pytest.warns(UserWarning, match=message):
        train("smdp-fitted-q", data=data, primitives=200, eval_episodes=0, settings=NETWORKS)
    with pytest.warns(UserWarning, match="Give it more data"):
        train("smdp-decision-transformer", data=data, primitives=200, eval_episodes=0,
              settings=SMALL["decision-transformer"])
    recwarn.clear()
    train("smdp-fitted-q", data=data, primitives=200, eval_episodes=0, settings={"values": "table"})
    assert not [each for each in recwarn if "decisions" in str(each.message)]


def test_a_data_sets_name_or_file_is_enough_and_the_run_knows_its_hash(tmp_path):
    result = train("smdp-fitted-q", data=save_small(), primitives=2_000, eval_episodes=0, out=tmp_path / "{key}")
    described = json.loads((result.folder / "run.json").read_text())
    assert described["data"]["digest"] == make_recording().digest


def test_what_does_not_fit_is_refused_with_what_would():
    data = load_data(make_recording(), observation="features")
    with pytest.raises(AgentSettingsError, match="behaviour-cloning"):
        train("smdp-dqn", data=data)
    with pytest.raises(AgentSettingsError, match="acts with primitives"):
        train("smdp-hiql", data=data)
    with pytest.raises(AgentSettingsError, match="2 actions|3 actions"):
        train("smdp-iql", make_recording().rooms.make_env(observation="features"), data=data)
    with pytest.raises(AgentSettingsError, match="unless there is data"):
        train("smdp-dqn", primitives=100)
    with pytest.raises(UnsupportedError, match="data="):
        env = make_recording().rooms.make_env(True, observation="features")
        train("smdp-iql+primitives", env, primitives=100, eval_episodes=0)
    assert not set(list_offline_agents()) & set(list_agents())


@pytest.mark.nightly_for("hiql", "fitted-q")
@pytest.mark.parametrize("name", ["iql", "hiql", "fitted-q"])
def test_who_acts_by_primitives_refuses_an_environment_of_options(name):
    data = load_data(make_recording(), observation="objects", rooms="own")
    with pytest.raises(AgentSettingsError, match="and 6 actions, as in the data set"):
        train(name, data.make_env(True, 0.99), data=data, settings=NETWORKS, eval_episodes=0)


def test_hiql_learns_what_is_left_of_an_option_at_each_of_its_primitives():
    """At its first primitive that is the whole decision, further on one primitive less of it."""
    data = load_data(make_recording(), observation="features")
    decisions, primitives = data.read_decisions(0.5), data.read_primitives()
    rest = cut_everywhere(decisions, primitives, 0.5, 9)
    begins = np.flatnonzero(primitives.begins)
    for field in ("reward", "summed_reward", "duration", "discount", "next_observation", "terminated", "last"):
        np.testing.assert_array_equal(getattr(rest, field)[begins], getattr(decisions, field))
    inside = np.flatnonzero(~primitives.begins)
    np.testing.assert_array_equal(rest.reward[inside - 1],
                                  primitives.reward[inside - 1] + 0.5 * rest.reward[inside])
    np.testing.assert_array_equal(rest.duration[inside - 1], rest.duration[inside] + 1)
    np.testing.assert_array_equal(rest.next_observation[inside - 1], rest.next_observation[inside])
    np.testing.assert_array_equal(rest.action, primitives.action)
    assert rest.mask.shape == rest.next_mask.shape == (len(primitives.action), 9)


@pytest.mark.nightly
def test_hiql_predicts_the_end_of_an_option_from_within_it_where_it_is_asked_when_it_acts():
    """Experts of one room: a network that was taught at their decisions alone misses by 0.19 of the spread."""
    recording = make_recording("expert").select(0)
    data = load_data(recording, observation="features", rooms="own")
    settings = {"network": "mlp", "learning_rate": 0.003, "passes": 50}
    result = train("hiql", recording.rooms[:1].make_env(observation="features"), data=data, settings=settings,
                   eval_episodes=0)
    agent = result.agent
    assert result.decisions == result.primitives  # each row teaches one
    ends, primitives = data.read_decisions(0.99).next_observation, data.read_primitives()
    inside = np.flatnonzero(~primitives.begins)
    wanted = ends[np.cumsum(primitives.begins)[inside] - 1]
    missed = np.stack([agent.networks["high"].compute(seen) for seen in primitives.observation[inside]]) - wanted
    assert np.mean(missed**2) < 0.05 * ends.var(axis=0).mean()


def test_over_rows_of_objects_a_network_is_learned_however_few_states_there_are():
    """Experts show each state often; a table of these states would know none of another room."""
    for observation, is_table in (("features", True), ("objects", False)):
        data = load_data(make_recording("expert"), observation=observation)
        agent = train("smdp-fitted-q", data=data, settings={"hidden": [8]}, primitives=2_000, eval_episodes=0).agent
        assert agent.is_table == is_table and bool(len(agent.q)) == is_table
