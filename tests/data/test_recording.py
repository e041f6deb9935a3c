"""Recordings: whole, of this engine, and refused by one clear message where they are not."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.data.materialise import load_data
from hrl_escape.data.recording import FIELDS, Recording, load_recording, save_recording
from hrl_escape.errors import ConfigError, EscapeError, FileReadError
from tests.data.small import make_recording, save_small


def test_a_recording_comes_back_as_it_was_in_less_than_a_byte_and_a_half_a_primitive(tmp_path):
    recording = make_recording()
    save_recording(tmp_path / "again.npz", recording)
    assert (tmp_path / "again.npz").read_bytes() == save_small().read_bytes()
    assert load_recording(tmp_path / "again.npz").digest == recording.digest
    assert len((tmp_path / "again.npz").read_bytes()) - 5_000 < 1.5 * len(recording.action)


def test_content_stays_from_version_to_version_and_changes_with_one_primitive():
    recording = make_recording()
    later = {**recording.about, "package": "9.9", "command": "another", "scores": {}}
    later = dataclasses.replace(recording, about=later)
    assert later.content == recording.content and later.digest != recording.digest
    action = recording.action.copy()
    action[-1] = 5 - action[-1]
    assert dataclasses.replace(recording, action=action).content != recording.content
    assert dataclasses.replace(recording, about={**recording.about, "rooms_id": "others"}).content != recording.content


@given(st.data())
def test_whatever_happens_to_the_bytes_of_a_recording_is_one_clear_message(tmp_path_factory, data):
    content = bytearray(save_small().read_bytes())
    if data.draw(st.booleans(), "cut"):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.mktemp("fuzzed") / "recording.npz"
    path.write_bytes(bytes(content))
    try:
        assert load_recording(path).digest == make_recording().digest  # bytes that mean nothing, such as a time
    except FileReadError as error:
        assert str(path) in str(error) and "\n" not in str(error)


def change(**arrays) -> Recording:
    return dataclasses.replace(make_recording(), **arrays)


def tell(**about) -> Recording:
    return change(about={**make_recording().about, **about})


def empty_one(counts: np.ndarray) -> np.ndarray:
    """The same sum, with nothing left in the second."""
    return np.array([counts[0] + counts[1], 0, *counts[2:]], counts.dtype)


@pytest.mark.parametrize(("recording", "words"), [
    (lambda: change(about={**make_recording().about, "engine": "mujoco"}), "its engine is 'mujoco'.*replays 'bullet'"),
    (lambda: change(about={**make_recording().about, "dynamics": "EscapeRoom-v0"}), "EscapeRoom-v0.*EscapeRoom-v1"),
    (lambda: change(about={**make_recording().about, "format": 3}), "its format is 3"),
    (lambda: tell(name=["x"]), r"about\.name = \['x'\] is not possible: text"),
    (lambda: tell(primitive_count=-1), r"about\.primitive_count = -1 .* from 0 to 64"),
    (lambda: tell(primitive_count=4), "3 actions, of which 4 are primitives"),
    (lambda: tell(actions=["x"] * 65), "has 65 actions"),
    (lambda: tell(actions="abc"), r"about\.actions = 'abc'"),
    (lambda: tell(scores={"best_known": "high"}), r"about\.scores\.best_known = 'high'"),
    (lambda: tell(surplus=1), "unknown field of about 'surplus'"),
    (lambda: change(room=make_recording().room - np.int32(1)), "room has numbers outside 0 to 999999"),
    (lambda: change(action=-1 - make_recording().action), "action has numbers outside 0 to 127"),
    (lambda: change(action=make_recording().action[:-1]), "durations stand for"),
    (lambda: change(action=np.append(make_recording().action, np.int8(0))), "durations stand for"),
    (lambda: change(option=make_recording().option[:-1]), "different lengths"),
    (lambda: change(option=make_recording().option + np.int16(9)), "option has numbers outside 0 to 2"),
    (lambda: change(decisions=make_recording().decisions + np.int32(1)), "decisions stand for"),
    (lambda: change(legal=make_recording().legal[:-1]), "legal stand for"),
    (lambda: change(duration=empty_one(make_recording().duration)), "a decision without primitives"),
    (lambda: change(decisions=empty_one(make_recording().decisions)), "an episode without decisions"),
])
def test_a_recording_of_another_engine_or_that_contradicts_itself_is_refused_by_name(tmp_path, recording, words):
    save_recording(tmp_path / "wrong.npz", recording())
    with pytest.raises(FileReadError, match=words):
        load_recording(tmp_path / "wrong.npz")


def test_an_episode_of_one_decision_is_whole(tmp_path):
    first, second, *others = make_recording().decisions.tolist()
    save_recording(tmp_path / "short.npz", change(decisions=np.array([first + second - 1, 1, *others], np.int32)))
    assert load_recording(tmp_path / "short.npz").decisions[1] == 1


def test_other_rooms_than_the_recordings_are_refused():
    about = {**make_recording().about, "rooms": "ladder-1/chain-3/train#0..2"}
    with pytest.raises(FileReadError, match="ladder-1/chain-3/train.*differs in this version"):
        _ = change(about=about).rooms


def test_rooms_and_primitives_that_are_not_there_are_refused_where_they_are_read():
    with pytest.raises(FileReadError, match=r"it has episodes in room 7, and .* has 2 rooms"):
        _ = change(room=np.full_like(make_recording().room, 7)).rooms
    with pytest.raises(FileReadError, match="episode 0 has the primitive 100, and its room 6 primitives"):
        load_data(change(action=np.full_like(make_recording().action, 100))).read()


def test_a_range_of_rooms_that_takes_all_memory_is_refused_by_its_length():
    with pytest.raises(ConfigError, match="a range holds at most 1,000,000 rooms"):
        _ = tell(rooms="paper-two-button#0..1000000000").rooms


def rewrite(path, name, content):
    """The recording with one member replaced."""
    with zipfile.ZipFile(save_small()) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.namelist():
            new.writestr(member, content if member == name else old.read(member))


def make_npy(array, shape=None):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": array.dtype.str, "fortran_order": False,
                                                  "shape": shape or array.shape})
    return buffer.getvalue() + array.tobytes()


@pytest.mark.parametrize(("name", "content", "words"), [
    ("action.npy", make_npy(np.zeros(10, np.int8), (10**9,)), "claims 1,000,000,000"),
    ("action.npy", make_npy(np.zeros(10, np.float64)), "float64"),
    ("action.npy", make_npy(np.zeros((2, 5), np.int8)), "2 x 5"),
    ("action.npy", make_npy(np.zeros(10, np.int8)), "does not have the hash that it states"),
    ("action.npy", b"", "magic|header|read"),
    ("about.npy", make_npy(np.frombuffer(b"{}", np.uint8)), "missing"),
    ("about.npy", make_npy(np.frombuffer(json.dumps({"digest": "0"}).encode(), np.uint8)), "missing"),
])
def test_members_that_claim_more_than_they_hold_are_refused_before_memory_is_taken(tmp_path, name, content, words):
    rewrite(tmp_path / "wrong.npz", name, content)
    with pytest.raises(FileReadError, match=words):
        load_recording(tmp_path / "wrong.npz")


@pytest.mark.nightly
def test_a_small_file_that_unpacks_to_gigabytes_is_refused_by_its_claim(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in (*FIELDS, "about"):
            archive.writestr(f"{name}.npy", make_npy(np.zeros(2**26 if name == "legal" else 1, np.uint64)))
    with pytest.raises(FileReadError, match="claims 536,8.*bytes"):
        load_recording(tmp_path / "bomb.npz")


def test_a_pickle_in_a_recording_is_never_loaded(tmp_path):
    buffer = io.BytesIO()
    np.save(buffer, np.array([print], dtype=object), allow_pickle=True)
    rewrite(tmp_path / "wrong.npz", "action.npy", buffer.getvalue())
    with pytest.raises(EscapeError, match="object"):
        load_recording(tmp_path / "wrong.npz")
