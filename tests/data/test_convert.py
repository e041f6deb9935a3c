"""Files of version 0.3: loading refuses them and names the command, and a conversion loses nothing."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from hrl_escape.agents.old_fields import rename_fields
from hrl_escape.data.convert import convert_data
from hrl_escape.data.recording import load_recording, save_recording
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import FileReadError, InstanceFileError, OldFormatError, VerificationError
from hrl_escape.sets.changes import change_config
from hrl_escape.text import load_games, record_game, save_games
from hrl_escape.viewer.play.episode import Episode, load_episode, save_episode
from tests.data.small import make_recording
from tests.text.rooms import get_room, make_session

OLD_WORDS = {"press-button-1": "press button-1", "press-button-2": "press button-2", "go-to-exit": "leave"}


def test_a_recording_gets_the_names_of_its_options(tmp_path: Path):
    recording, path, out = make_recording(), tmp_path / "old.npz", tmp_path / "new.npz"
    assert recording.about["actions"] == ["press-button-1", "press-button-2", "go-to-exit"]
    rooms = recording.about["rooms"]
    assert rooms == "ladder-1/pair/train#0..2"
    old = {**recording.about, "format": 1, "actions": ["meta-01", "meta-02", "meta-exit"],
           "rooms": "ladder-1/pair/train[:2]"}
    save_recording(path, dataclasses.replace(recording, about=old))
    with pytest.raises(OldFormatError, match="this recording is of version 0.3. `hrl-escape convert .*old.npz`"):
        load_recording(path)
    assert convert_data(path, out) == f"the recording {recording.about['name']}"
    again = load_recording(out)
    assert (again.digest, again.content) == (recording.digest, recording.content)
    assert load_recording(path, version=1).content == recording.content, "its published hash is the same"


def write_old_games(path: Path, **score: object) -> None:
    """Games of this version in the form of the last one; some numbers of their scores changed."""
    session = make_session(get_room("pair"), "names", seed=3, include_primitives=True, option_set="press-reactive")
    for name in ("press-button-2", "press-button-1", "press-button-2", "go-to-exit"):
        session.call("run_option", {"option": name})
    session.call("fly", {})
    save_games(path, [record_game(session)])
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    first, last = lines[0], lines[-1]
    first |= {"schema": 1, "told": first.pop("reveal"), "options": {"flavour": "press-markov"}}
    last["score"] |= {"characters": 1, **score}
    for line in lines[1:-1]:
        line["text"] = "other words"
        if line["call"][0] == "run_option":
            line["call"][1] = {"option": OLD_WORDS[line["call"][1]["option"]]}
    path.with_name("old.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))


def test_recorded_games_are_played_again_with_the_new_names(tmp_path: Path):
    write_old_games(tmp_path / "now.jsonl")
    with pytest.raises(OldFormatError, match="this recorded game is of version 0.3. `hrl-escape convert .*old.jsonl`"):
        load_games(tmp_path / "old.jsonl")
    assert convert_data(tmp_path / "old.jsonl", tmp_path / "new.jsonl") == "1 recorded games"
    assert (tmp_path / "new.jsonl").read_bytes() == (tmp_path / "now.jsonl").read_bytes()


@pytest.mark.parametrize("primitives", [1, 900])
def test_a_game_that_goes_otherwise_is_not_converted(primitives: int, tmp_path: Path):
    write_old_games(tmp_path / "now.jsonl", primitives=primitives)
    differs = f"'pair.*' has another primitives when it is played again: .*, not {primitives}"
    with pytest.raises(VerificationError, match=differs):
        convert_data(tmp_path / "old.jsonl", tmp_path / "new.jsonl")


@pytest.mark.parametrize("schema", [1, 2])
def test_an_episode_of_a_person_gets_the_names_of_its_moves(schema: int, tmp_path: Path):
    episode = Episode(generate(get_preset("paper-two-button"), 0))
    for name in ("forward", "press-button-1", "press-button-2", "go-to-exit"):
        episode.do(episode.names.index(name))
    save_episode(tmp_path / "now.json", episode.to_saved())
    content = json.loads((tmp_path / "now.json").read_text())
    numbered = {"press-button-1": "meta-01", "press-button-2": "meta-02", "go-to-exit": "meta-exit"}
    moves = [move | {"name": numbered.get(move["name"], move["name"])} for move in content["moves"]]
    old = content | {"schema": schema, "moves": moves}
    if schema == 1:
        del old["end"]
    (tmp_path / "old.json").write_text(json.dumps(old))
    with pytest.raises(OldFormatError, match="this recorded episode is of version 0.3"):
        load_episode(tmp_path / "old.json")
    assert convert_data(tmp_path / "old.json", tmp_path / "new.json") == "a recorded episode"
    saved, now = load_episode(tmp_path / "new.json"), load_episode(tmp_path / "now.json")
    assert saved == (now if schema == 2 else dataclasses.replace(now, end=None))
    again = Episode(saved.instance, seed=saved.seed)
    again.replay(saved)
    assert again.end is episode.end


def test_symbols_of_buttons_get_their_new_name_in_a_saved_room(tmp_path: Path):
    room = generate(change_config(get_preset("four-button-chain"), {"puzzle.cues.kind": "needed"}), 0)
    room.save(tmp_path / "now.json")
    content = json.loads((tmp_path / "now.json").read_text())
    content["puzzle"]["marks"] = content["puzzle"].pop("cues")
    (tmp_path / "old.json").write_text(json.dumps(content | {"id": "of-0.3"}))
    with pytest.raises(OldFormatError, match="this room is of version 0.3. `hrl-escape convert .*old.json`"):
        RoomInstance.load(tmp_path / "old.json")
    assert convert_data(tmp_path / "old.json", tmp_path / "new.json") == f"the room {room.name}"
    assert (tmp_path / "new.json").read_bytes() == (tmp_path / "now.json").read_bytes()
    content["puzzle"]["edge_list"] = [[0, 9]]
    (tmp_path / "old.json").write_text(json.dumps(content))
    with pytest.raises(InstanceFileError, match=r"old\.json: not a room instance: .*9"):
        convert_data(tmp_path / "old.json", tmp_path / "another.json")
    assert not (tmp_path / "another.json").exists()


def test_fields_get_their_new_names_at_any_depth():
    old = {"environment": {"wrappers": [
        {"class": "hrl_escape.options.options_env:OptionsEnv", "arguments": {"flavour": "press-markov", "trace": True}},
        {"class": "hrl_escape.text.told_env:ToldEnv", "arguments": {"told": "names"}},
        {"class": "hrl_escape.synthesis.hierarchy_env:HierarchyEnv", "arguments": {"kind": "maxq"}}]},
        "told": "nothing"}
    new = {"environment": {"wrappers": [
        {"class": "hrl_escape.options.options_env:OptionsEnv",
         "arguments": {"option_set": "press-reactive", "trace": True}},
        {"class": "hrl_escape.text.text_env:TextEnv", "arguments": {"reveal": "names"}},
        {"class": "hrl_escape.hierarchies.hierarchy_env:HierarchyEnv", "arguments": {"kind": "maxq"}}]},
        "told": "nothing"}
    assert rename_fields(old) == new and rename_fields(new) == new


def test_other_files_are_left_to_others(tmp_path: Path):
    for name, text in (("grid.json", '{"name": "mine"}'), ("notes.txt", ""), ("game.jsonl", '{"kind": "other"}\n')):
        (tmp_path / name).write_text(text)
        assert convert_data(tmp_path / name, tmp_path / "new") is None
    with pytest.raises(FileReadError):
        convert_data(tmp_path / "missing.json", tmp_path / "new")
    assert not (tmp_path / "new").exists()
