"""Sets of rooms by a short text."""

import pytest

from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.room_sets import parse_room_set


def test_texts_name_the_rooms_of_rungs_presets_and_files(tmp_path):
    train = load_benchmark("ladder-1")["doormat"].train
    assert list(parse_room_set("ladder-1/doormat/train").seeds) == list(train.seeds)
    assert list(parse_room_set("ladder-1/doormat/train[2:5]").seeds) == list(train.seeds[2:5])
    assert list(parse_room_set("ladder-1/doormat/train[:3]").seeds) == list(train.seeds[:3])
    assert list(parse_room_set("ladder-1/doormat/train[250:]").seeds) == list(train.seeds[250:])
    (room,) = parse_room_set("ladder-1/doormat/train[7]")
    assert room == train[7]
    rooms = [generate(get_preset("clutter"), seed) for seed in (3, 4)]
    assert list(parse_room_set("clutter#3..4")) == rooms
    assert list(parse_room_set("clutter").seeds) == [0]
    train[:4].save(tmp_path / "few.json")
    assert parse_room_set(str(tmp_path / "few.json"))[:4].ids == train[:4].ids


@pytest.mark.parametrize(("text", "error", "words"), [
    ("ladder-1/doormat/train[]", ConfigError, "train\\[:64\\]"),
    ("ladder-1/doormat/train[4000]", ConfigError, "1000 rooms"),
    ("ladder-1/doormat/train[5:5]", ConfigError, "at least one"),
    ("ladder-1/doormat/trian", UnknownNameError, "train"),
    ("ladder-1/doormatt/train", UnknownNameError, "doormat"),
    ("clutter#5..2", ConfigError, "clutter#0..15"),
    ("cluttered", UnknownNameError, "clutter"),
    ("nowhere.json", FileReadError, "nowhere.json"),
])
def test_texts_that_name_no_rooms_are_refused_with_what_would_do(text, error, words):
    with pytest.raises(error, match=words):
        parse_room_set(text)
