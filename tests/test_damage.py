"""Rooms, grids, room configurations and episodes in files are read or refused in words, whatever is in them."""

from __future__ import annotations

import json
import random

import pytest

from hrl_escape.benchmark.grid import load_grid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError
from hrl_escape.files import read_toml
from hrl_escape.sets.grammar import find_config
from hrl_escape.viewer.play.episode import SavedEpisode, load_episode, save_episode
from tests.agents.training.test_damage import change_bytes, change_value
from tests.benchmark.small import SCHEMATIC, SMALL
from tests.command_line import call


@pytest.fixture(scope="module")
def room():
    return generate(get_preset("paper-two-button"), 0)


def make_json(kind, room, path):
    """Sound content of a file of a kind, and the function that reads it."""
    if kind == "room":
        return room.to_dict(), RoomInstance.load
    if kind == "grid":
        return SMALL.to_dict(), load_grid
    if kind == "room configuration":
        return SCHEMATIC.to_dict(), lambda path: find_config(str(path))
    save_episode(path, SavedEpisode(room, 0, (("forward", (0, 0), "done"),), -2.0, False))
    return json.loads(path.read_text()), load_episode


@pytest.mark.nightly_for("values-episode")
@pytest.mark.parametrize("kind", ["room", "grid", "room configuration", "episode"])
@pytest.mark.parametrize("how", ["bytes", "values"])
def test_a_changed_file_is_read_or_refused_in_words(tmp_path, room, kind, how):
    path = tmp_path / "x.json"
    content, read = make_json(kind, room, path)
    chance = random.Random(kind + how)
    for _ in range(150):
        if how == "bytes":
            path.write_bytes(change_bytes(json.dumps(content).encode(), chance))
        else:
            path.write_text(json.dumps(change_value(content, chance)))
        try:
            read(path)
        except EscapeError as error:
            assert str(error).strip() and len(str(error)) < 3_000


@pytest.mark.parametrize("text", [
    "[room]\nwidth = 0x" + "f" * 5_000, "horizon = 0x" + "f" * 5_000, "[room]\nwidth = " + "[" * 90 + "]" * 90,
    "[" + "a." * 90 + "b]\nc = 1", "x" * 5_000 + " = 1"])
def test_an_extreme_room_configuration_is_one_short_line(tmp_path, capsys, text):
    (tmp_path / "x.toml").write_text(text)
    assert read_toml(tmp_path / "x.toml")
    code, _, err = call(capsys, "room", "--room", tmp_path / "x.toml")
    assert code == 2 and err.count("\n") == 1 and len(err) < 2_000
