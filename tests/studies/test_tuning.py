"""The record of tuning tells the defaults of today, of agents, rooms and commits that exist."""

from __future__ import annotations

import dataclasses

import pytest

from hrl_escape.agents.registry import get_recipe, join_name, list_agents
from hrl_escape.env.presets import PRESETS
from studies.tuning import Tuning, load_tuning

RECORD = load_tuning()


@pytest.mark.parametrize("entry", RECORD, ids=lambda entry: "+".join(entry.agents))
def test_tuned_defaults_are_those_of_today(entry: Tuning):
    assert set(entry.agents) <= set(list_agents())
    for agent in (*entry.agents, *(join_name(agent, True) for agent in entry.agents)):
        defaults = dataclasses.asdict(get_recipe(agent))
        assert {name: defaults[name] for name in entry.settings} == entry.settings, agent
    assert set(entry.before) <= set(entry.settings)
    assert all(entry.before[name] != entry.settings[name] for name in entry.before)


@pytest.mark.parametrize("entry", RECORD, ids=lambda entry: "+".join(entry.agents))
def test_an_entry_says_where_settings_were_tried_and_what_of_it_is_reported(entry: Tuning):
    assert entry.tried_in and entry.source
    assert set(entry.reported_in) <= set(entry.tried_in) <= {*PRESETS, "CartPole-v1"}


def test_no_setting_of_an_agent_is_told_twice():
    told = [(agent, name) for entry in RECORD for agent in entry.agents for name in entry.settings]
    assert len(set(told)) == len(told)
