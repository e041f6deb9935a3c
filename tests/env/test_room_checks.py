"""Rooms from outside: whatever was edited into nonsense is refused, whatever was generated is taken."""

import copy
import dataclasses
import json

import pytest

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError, EscapeError, FileReadError, InstanceFileError, show_value

ROOM = generate(get_preset("clutter"), 0)


def edit(path, value):
    data = copy.deepcopy(ROOM.to_dict())
    *way, last = path
    part = data
    for step in way:
        part = part[step]
    if value is KeyError:
        del part[last]
    else:
        part[last] = value
    return data


EDITS = [
    (("solids",), []), (("solids",), list(ROOM.to_dict()["solids"])[1:]), (("door",), None),
    (("exit", "x_min"), 1e5), (("starts",), []), (("starts", 0, "x"), 9.9), (("starts", 0, "x"), 1e6),
    (("starts", 0, "heading_steps"), 300), (("dynamics", "press_with"), "hand"), (("schema",), True),
    (("schema",), 10**4000), (("horizon",), KeyError), (("robot", "body_radius"), KeyError),
    (("solids", 0, "x"), KeyError), (("puzzle", "goal"), KeyError), (("puzzle", "kind"), ["buttons"]),
    (("puzzle", "kind"), {}), (("name",), 5), (("robot",), None), (("targets", 0, "y"), 1e6), (("exit", "x_max"), 1e5),
    (("puzzle",), "buttons"), (("targets", 0), 7),
]


@pytest.mark.parametrize(("path", "value"), EDITS, ids=range(len(EDITS)))
def test_an_edited_room_is_refused_in_one_short_sentence(path, value):
    with pytest.raises(InstanceFileError) as refusal:
        RoomInstance.from_dict(edit(path, value))
    assert len(str(refusal.value)) < 500


def test_a_target_beyond_the_walls_is_refused_with_the_floor():
    with pytest.raises(InstanceFileError, match=r"targets\[0\] = \(30\.0, .*a centre on the floor, \|x\| <= 10 m"):
        RoomInstance.from_dict(edit(("targets", 0, "x"), 30.0))


def test_a_file_keeps_its_id_and_one_without_is_refused(tmp_path):
    file = tmp_path / "room.json"
    ROOM.save(file)
    assert RoomInstance.load(file) == ROOM
    data = json.loads(file.read_text())
    data["horizon"] = 5
    file.write_text(json.dumps(data))
    with pytest.raises(InstanceFileError, match="edited"):
        RoomInstance.load(file)
    del data["id"]
    file.write_text(json.dumps(data))
    with pytest.raises(InstanceFileError, match="None"):
        RoomInstance.load(file)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"schema": ' + "9" * 5000 + "}", '{"a":' * 5000, "7", "null", "[]"],
                         ids=show_value)
def test_files_that_would_exhaust_a_reader_are_refused(tmp_path, text):
    file = tmp_path / "room.json"
    file.write_text(text)
    with pytest.raises((FileReadError, InstanceFileError)) as refusal:
        RoomInstance.load(file)
    assert len(str(refusal.value)) < 500


def test_an_environment_refuses_a_room_without_walls_and_a_start_in_one():
    for broken in (dataclasses.replace(ROOM, solids=()),
                   dataclasses.replace(ROOM, starts=(dataclasses.replace(ROOM.starts[0], x=9.9),))):
        for make in (EscapeRoomEnv, EscapeRoomVectorEnv):
            with pytest.raises(ConfigError):
                make(instance=broken)


@pytest.mark.parametrize("arguments", [
    {"render_size": "ab"}, {"render_size": (640,)}, {"render_size": (640, 4.5)}, {"render_size": None},
    {"render_size": (0, 10**9)}, {"config": 5}, {"config": None}, {"config": {"puzzle": {"kind": []}}},
    {"config": {"puzzle": {"kind": {}}}}, {"instance_seed": "0"}, {"instance_seed": -1}, {"instance": 5},
    {"instance": []}, {"observation": []}, {"observation": 5}, {"camera": []}, {"camera": None}, {"engine": []},
    {"render_mode": []}, {"config": "x" * 10**6}, {"config": {"x" * 10**6: 1}}, {"config": {"horizon": 10**5000}},
], ids=show_value)
def test_arguments_of_other_kinds_are_refused_in_one_short_sentence(arguments):
    with pytest.raises(EscapeError) as refusal:
        EscapeRoomEnv(**arguments)
    assert len(str(refusal.value)) < 1000


@pytest.mark.parametrize("arguments", [
    {"num_envs": 1.5}, {"num_envs": 0}, {"num_instances": 1.5}, {"num_instances": "2"}, {"instance_seed": 0.5},
    {"device": "meta"}, {"device": 5.5}, {"device": []}, {"autoreset_mode": []}, {"output": []}, {"instance": [5]},
    {"instance": []}, {"observation": {}}, {"config": 3},
], ids=str)
def test_arguments_of_batches_of_other_kinds_are_refused(arguments):
    with pytest.raises(EscapeError):
        EscapeRoomVectorEnv(**arguments)
