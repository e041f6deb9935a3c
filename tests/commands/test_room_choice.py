"""The options of version 0.3 that chose a room: each stops with one message that shows the new form."""

from __future__ import annotations

import shlex

import pytest

from hrl_escape.cli import main
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.sets import make_room
from tests.command_line import assert_refused


@pytest.mark.parametrize(("line", "advice"), [
    ("solve --preset clutter --seed 3", "write --room clutter#3"),
    ("solve --preset=clutter --seed=3", "write --room clutter#3"),
    ("play --preset clutter", "write --room clutter"),
    ("watch --preset clutter", "write --room clutter"),
    ("watch --seed 3", "write --room paper-two-button#3 for this room, or --room paper-two-button --seed 3"),
    ("record --load room.json", "write --room room.json"),
    ("room --seed 4", "write --room paper-two-button#4"),
    ("room --set horizon=5 --seed 4", "write --room custom#4"),
    ("room --room clutter --seed 4", "write --room clutter#4"),
    ("room --preset larg-2019 --arguments size=4 seed=3 --seed 2", "write --room 'larg-2019(size=4, seed=3)#2'"),
    ("room --config my-config.toml --seed 2", "write --room my-config.toml#2"),
    ("mcp --rung lattice --room test#3", "write --room ladder-1/lattice/test#3"),
    ("mcp --rung colours --benchmark cues-1", "write --room cues-1/colours/test#0"),
    ("train dqn --seed 3", "write --room paper-two-button#3 for this room, or --room paper-two-button --seed 3"),
    ("train dqn --preset clutter --seed 3", "write --room clutter#3"),
    ("train dqn --preset clutter --seed 3 --training-seed 7", "write --room clutter#3 --seed 7"),
    ("train dqn --training-seed 7", "write --room paper-two-button --seed 7"),
    ("train dqn --room clutter --training-seed 7", "write --room clutter --seed 7"),
    ("compare --rooms clutter ladder-1/pair/train[3]", "write --room clutter ladder-1/pair/train#3"),
    ("compare --rooms clutter#0..15", "write --room clutter#0..16"),
    ("data make mine --rooms ladder-1/pair/train[:4] --played x", "write --room ladder-1/pair/train#0..4"),
])
def test_an_old_option_shows_the_new_form_with_the_values_given(capsys, tmp_path, monkeypatch, line, advice):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, shlex.split(line), advice)
    assert list(tmp_path.iterdir()) == []


def test_the_training_seed_goes_with_a_room_or_with_data(capsys):
    assert main(["train", "dqn", "--room", "clutter", "--seed", "3", "--list-settings"]) == 0
    assert main(["train", "iql", "--data", "pair-play-v1", "--seed", "3", "--list-settings"]) == 0


def test_a_room_is_named_by_one_option():
    assert RoomChoice("clutter#3").make_instance() == make_room("clutter#3") == generate(get_preset("clutter"), 3)
    assert RoomChoice().make_instance().name == "paper-two-button"
    assert RoomChoice(set=("horizon=50",)).make_instance() == make_room("custom", {"horizon": 50})
    assert RoomChoice("clutter#3", ("horizon=50",)).find_config().horizon == 50
    assert RoomChoice("ladder-1/pair/test#5").make_instance() == make_room("ladder-1/pair/test#5")
