"""`hrl-escape list`: every name there is, with a line about it."""

import json

import gymnasium
import pytest

from hrl_escape.agents.recommended import RECOMMENDED
from hrl_escape.agents.registry import (
    get_agent_class,
    list_across_rooms_agents,
    list_agents,
    list_continuous_agents,
    list_hierarchy_agents,
    list_many_env_agents,
)
from hrl_escape.agents.spec import PARTS
from hrl_escape.env.engine import CAMERAS
from hrl_escape.env.observations.base import list_observations
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.primitives import make_action_table
from tests.command_line import call


def test_list_shows_everything_there_is_with_a_line_about_it(capsys):
    code, out, _ = call(capsys, "list", "--json")
    lists = json.loads(out)
    assert code == 0 and "recipes" not in lists, "what imports every algorithm is not listed unasked"
    assert set(lists["presets"]) == set(PRESETS) and set(lists["cameras"]) == set(CAMERAS)
    assert set(lists["observations"]) == {observation.name for observation in list_observations()}
    assert {"buttons", "bit-flip", "push-block"} <= set(lists["puzzles"])
    assert list(lists["primitives"])[:6] == list(make_action_table(0).names)
    assert all(len(line) > 8 for entries in lists.values() for line in entries.values())
    assert "3-joint arm" in lists["presets"]["arm-two-button"]
    code, out, _ = call(capsys, "list", "cameras")
    assert code == 0 and "overhead" in out and "clutter" not in out
    assert call(capsys, "list", "camera")[0] == 2


def test_each_agent_is_described_by_its_own_file(capsys):
    _, out, _ = call(capsys, "list", "agents", "--json")
    described = json.loads(out)["agents"]
    assert list(described) == [*list_agents(), *list_hierarchy_agents(), *list_continuous_agents(),
                               *list_across_rooms_agents()]
    assert {"dqn", "maxq-q", "hiro"} <= set(described)
    own = [name for name in described if get_agent_class(name).__module__.startswith("hrl_escape.")]
    assert len(own) > 40 and not any(described[name].startswith("From another package") for name in own)
    assert described["q-learning"] == "Tabular Q-learning over decisions of any duration"
    assert len({described[name] for name in own}) == len(own)


def test_lists_are_read_from_what_they_list(capsys):
    lists = json.loads(call(capsys, "list", "environments", "parts", "recommended", "--json")[1])
    ids = {name for name, spec in gymnasium.registry.items() if spec.namespace == "hrl_escape"}
    assert set(lists["environments"]) == ids >= {"hrl_escape/EscapeRoom-v1", "hrl_escape/EscapeRoomContinuous-v1"}
    assert lists["environments"]["hrl_escape/ClutterOptions-v1"] == "preset clutter, with options"
    assert set(lists["parts"]) == {f"+{name}" for name in PARTS}
    assert list(lists["recommended"]) == [choice.label for choice in RECOMMENDED]


@pytest.mark.slow  # imports every algorithm
def test_recipes_and_agents_of_many_rooms_are_listed_where_they_are_asked_for(capsys):
    lists = json.loads(call(capsys, "list", "recipes", "batched", "--json")[1])
    assert lists["recipes"]["h-dqn"] == "default, table or patient"
    assert lists["recipes"]["dqn"] == "default, patient or keras-rl-2019"
    assert list(lists["batched"]) == list_many_env_agents() and "rainbow" in lists["batched"]


def test_sentences_are_whole(capsys):
    lists = json.loads(call(capsys, "list", "--json")[1])
    assert lists["puzzles"]["deep-sea"].startswith("Deep Sea (Osband et al. 2019")
    lines = [line for entries in lists.values() for line in entries.values()]
    assert not [line for line in lines if line.endswith("et al") or line.count("(") != line.count(")")]
    assert {"search-nearest", "oracle"} <= set(lists["references"])
