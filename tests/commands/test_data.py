"""`hrl-escape data`: record, list, show and export a data set, as a user would."""

import dataclasses
import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.data.catalogue import RECORDING_KINDS, RECORDING_SIZES
from hrl_escape.data.materialise import load_data
from hrl_escape.data.published import read_published
from hrl_escape.data.record import train_medium
from hrl_escape.data.recording import load_recording, save_recording
from hrl_escape.errors import VerificationError
from tests.command_line import assert_refused, call

NAME, MADE = "pair-play-1m-v1", ("data", "make", "pair-play-1m-v1", "--primitives", "1000")


@pytest.fixture
def folder(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, *MADE)
    assert code == 0, err
    assert NAME in out and out.count("\n") == 1
    return tmp_path


def test_a_recording_is_listed_shown_drawn_and_made_only_once(capsys, folder):
    path = folder / "data" / f"{NAME}.npz"
    size, made = path.stat().st_size, path.stat().st_mtime_ns
    assert call(capsys, *MADE)[0] == 0 and path.stat().st_mtime_ns == made
    rows = {row["name"]: row for row in json.loads(call(capsys, "data", "list", "--rung", "pair", "--json")[1])}
    assert rows[NAME]["bytes"] == size and rows["pair-play-v1"]["bytes"] > size
    published = {name for name in read_published() if name.startswith("pair-")}
    here = {f"pair-{kind}-v1" for kind in RECORDING_KINDS} | {NAME}
    assert here <= published == set(rows)
    assert {name for name, row in rows.items() if row["here"]} == here
    scores = load_data(NAME, observation="features").recording.about["scores"]  # a trial's own, not the published
    assert (rows[NAME]["mean_return"], rows[NAME]["escapes"]) == (scores["mean_return"], scores["escapes"])
    assert 1_000 <= rows[NAME]["primitives"] < 2_000 and rows["pair-play-v1"]["primitives"] == 100_530
    code, _, err = call(capsys, "data", "list", "--rung", "lattis")
    assert code == 2 and "unknown rung with data sets 'lattis'" in err and "lattice" in err
    listed = call(capsys, "data", "list")[1].splitlines()
    assert "play: legal options, drawn uniformly" in listed and sum("-v1 " in line for line in listed) == len(
        json.loads(call(capsys, "data", "list", "--json")[1])) == len(listed) - len(RECORDING_KINDS) - 2
    card = json.loads(call(capsys, "data", "show", NAME, "--json", "--draw", "card.svg")[1])
    recording = load_data(NAME, observation="features").recording
    assert card["primitives"] == len(recording.action) >= 1_000 and card["decisions"] == len(recording.option)
    assert card["made_by"] == f"hrl-escape data make {NAME} --primitives 1000" and card["digest"] == recording.digest
    assert card["scores"]["chance"] < card["scores"]["best_known"]
    assert (folder / "card.svg").read_bytes().startswith(b"<?xml")
    assert recording.digest in call(capsys, "data", "show", str(path))[1]


def plant(monkeypatch, folder, name, content, decisions):
    """Let 1,000 primitives be all of a recording, and the table of published recordings tell what it must be."""
    table = folder / f"{name}-{content[:4]}-{decisions}.toml"  # each is read once
    table.write_text(f'{name} = {{content = "{content}", bytes = 5000, primitives = 1000, decisions = {decisions}, '
                     'episodes = 17, scores = {mean_return = 37.125, escapes = 1.0}}\n')
    monkeypatch.setitem(RECORDING_SIZES, "1m", 1_000)
    monkeypatch.setattr("hrl_escape.data.published.PUBLISHED", table)


@pytest.mark.nightly
def test_a_recording_is_told_to_be_the_published_recording_or_refused_for_what_differs(capsys, folder, monkeypatch):
    recording = load_data(NAME, observation="features").recording
    (folder / "data" / f"{NAME}.npz").unlink()
    plant(monkeypatch, folder, NAME, recording.content, len(recording.option))
    code, out, _ = call(capsys, "data", "make", NAME)
    assert code == 0 and out.endswith("it is the published recording\n")
    plant(monkeypatch, folder, NAME, "0" * 64, len(recording.option) + 1)
    found = (f"{NAME} is not the published recording: it holds {len(recording.option):,} decisions where that has "
             f"{len(recording.option) + 1:,}")
    assert_refused(capsys, ["data", "make", NAME], found)
    assert_refused(capsys, ["data", "make", NAME], "another version of an engine made it")
    there, other = Path("data") / f"{NAME}.npz", Path("data") / f"{NAME}.other.npz"
    assert_refused(capsys, ["data", "make", NAME], f"{there}: {found}")  # one that lies there already
    there.unlink()
    assert_refused(capsys, ["data", "make", NAME], f"{other}: {found}")
    assert_refused(capsys, ["data", "make", NAME], "Give its path to use it")
    assert other.is_file() and not there.exists()  # it does not bear the published name
    assert load_data(other, observation="features").recording.content == recording.content
    code, out, err = call(capsys, "data", "make", NAME, "pair-expert-1m-v1")
    assert code == 2 and out.startswith("<Recording pair-expert-1m-v1") and found in err
    plant(monkeypatch, folder, "pair-noisy-1m-v1", "0" * 64, 1)
    assert call(capsys, "data", "make", NAME)[1].endswith("no recording of this name is published\n")


@pytest.mark.nightly
def test_a_recording_of_medium_may_differ_and_says_so_but_a_trial_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(train_medium.__globals__, "MEDIUM_PRIMITIVES", 40)
    name = "pair-medium-1m-v1"
    plant(monkeypatch, tmp_path, name, "0" * 64, 1)
    for _ in ("recorded", "found"):
        code, out, _ = call(capsys, "data", "make", name)
        assert code == 0 and "it is not the published recording: it holds" in out and "train another network" in out
    assert (tmp_path / "data" / f"{name}.npz").is_file()
    monkeypatch.setitem(RECORDING_SIZES, "1m", 3_000)
    assert_refused(capsys, ["data", "make", name], "Another number of primitives")


def test_what_is_loaded_by_a_published_name_and_is_another_says_so(capsys, folder, monkeypatch):
    path = folder / "data" / f"{NAME}.npz"
    recording = load_recording(path)
    words = f"^{NAME} .*it is a trial and is not the published recording.*{recording.content[:12]}"
    with pytest.warns(UserWarning, match=words):
        assert load_data(NAME, observation="features").recording.content == recording.content
    plant(monkeypatch, folder, NAME, "0" * 64, len(recording.option) + 1)  # all of a recording, of another engine
    with pytest.raises(VerificationError, match=f"it holds {len(recording.option):,} decisions where .* Give its path"):
        load_data(NAME, observation="features")
    save_recording(folder / "data" / "pair-medium-1m-v1.npz", recording)
    plant(monkeypatch, folder, "pair-medium-1m-v1", "0" * 64, 1)
    with pytest.warns(UserWarning, match="it is not the published recording.*train another network"):
        load_data("pair-medium-1m-v1", observation="features")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_data(path, observation="features")
        load_data("pair-play-v1", observation="features")  # no recording of this name is in the table now
        plant(monkeypatch, folder, NAME, recording.content, len(recording.option))
        load_data(NAME, observation="features")


@pytest.mark.nightly
@pytest.mark.parametrize("asked", ["800", "1500"])
def test_a_trial_is_warned_of_whether_shorter_or_longer_than_its_name_says(capsys, folder, monkeypatch, asked):
    path = folder / "data" / f"{NAME}.npz"
    path.unlink()
    plant(monkeypatch, folder, NAME, "0" * 64, 1)
    assert call(capsys, *MADE[:-1], asked)[0] == 0
    with pytest.warns(UserWarning, match=f"^{NAME} .*it is a trial and is not the published recording"):
        load_data(NAME, observation="features")
    assert_refused(capsys, ["data", "make", NAME], "Another number of primitives")  # it does not bear the name


def test_ones_own_play_under_a_published_name_is_warned_of_as_such(capsys, folder, monkeypatch):
    path = folder / "data" / f"{NAME}.npz"
    recording = load_recording(path)
    plant(monkeypatch, folder, NAME, "0" * 64, len(recording.option) + 1)
    save_recording(path, dataclasses.replace(recording, about={**recording.about, "kind": "played"}))
    with pytest.warns(UserWarning, match=f"^{NAME} .*it is one's own play and is not the published recording"):
        load_data(NAME, observation="features")
    assert_refused(capsys, ["data", "make", NAME], "is one's own play")


def test_a_recording_of_equal_counts_and_another_content_says_so(capsys, folder, monkeypatch):
    """Also one that an older version recorded, which does not tell how many primitives it was asked for."""
    path = folder / "data" / f"{NAME}.npz"
    recording = load_recording(path)
    about = {key: value for key, value in recording.about.items() if key != "asked_primitives"}
    save_recording(path, dataclasses.replace(recording, about=about))
    table = folder / "equal.toml"
    table.write_text(f'{NAME} = {{content = "{"0" * 64}", bytes = 5000, primitives = {len(recording.action)}, '
                     f'decisions = {len(recording.option)}, episodes = {len(recording.room)}, '
                     "scores = {mean_return = 1.0}}\n")
    monkeypatch.setattr("hrl_escape.data.published.PUBLISHED", table)
    with pytest.warns(UserWarning, match="it is a trial and .* it holds equal counts but different content"):
        load_data(NAME, observation="features")
    monkeypatch.setitem(RECORDING_SIZES, "1m", 1_000)
    with pytest.raises(VerificationError, match="it holds equal counts but different content"):
        load_data(NAME, observation="features")


@pytest.mark.nightly
def test_the_table_of_published_recordings_is_read_once(capsys, folder, monkeypatch):
    """A table that is gone after the first look serves recordings of several names."""
    plant(monkeypatch, folder, NAME, load_recording(folder / "data" / f"{NAME}.npz").content, 1)
    assert set(read_published()) == {NAME}
    (table,) = folder.glob("*.toml")
    table.unlink()
    code, out, err = call(capsys, "data", "make", NAME, "pair-expert-1m-v1")
    assert code == 0 and "it is the published recording" in out and "no recording of this name is published" in out, err


def test_a_published_recording_tells_its_size_and_scores_before_it_is_recorded(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant(monkeypatch, tmp_path, NAME, "0" * 64, 130)
    (row,) = json.loads(call(capsys, "data", "list", "--rung", "pair", "--json")[1])[-1:]
    assert (row["name"], row["here"], row["bytes"], row["mean_return"]) == (NAME, False, 5_000, 37.125)
    shown = [line for line in call(capsys, "data", "list", "--rung", "pair")[1].splitlines() if NAME in line]
    assert "5,000" in shown[0] and "37.1" in shown[0] and " no " in shown[0]
    card = json.loads(call(capsys, "data", "show", NAME, "--json")[1])
    assert card["decisions"] == 130 and card["scores"]["escapes"] == 1.0 and card["content"] == "0" * 64
    assert card["recorded"] == f"not here: hrl-escape data make {NAME}"
    here = json.loads(call(capsys, "data", "show", "pair-play-v1", "--json")[1])
    assert list(card) == list(here) and card["digest"] is card["endings"] is None
    assert "digest" not in call(capsys, "data", "show", NAME)[1]
    assert_refused(capsys, ["data", "show", NAME, "--draw", "card.png"], "has not been recorded here")


@pytest.mark.slow
def test_a_million_primitives_recorded_anew_are_the_published_recording(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, "data", "make", NAME)
    assert code == 0 and out.endswith("it is the published recording\n"), err


@pytest.mark.parametrize(("level", "rows"), [("decisions", "read"), ("primitives", "read_primitives")])
def test_an_exported_set_holds_what_was_recorded(capsys, folder, level, rows):
    code, out, _ = call(capsys, "data", "export", NAME, "--level", level, "--out", "there")
    assert code == 0
    found = [dict(np.load(folder / name)) for name in out.removeprefix("wrote ").strip().split(" and ")]
    whole = getattr(load_data(NAME, observation="features"), rows)()
    last = sum(part["terminals"].sum() for part in found)
    assert sum(len(part["actions"]) - part["terminals"].sum() for part in found) == len(whole.action)
    assert last == whole.trajectory[-1] + 1


def test_mistakes_are_one_line_each(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, ["data", "show", "pair-plya-v1"], "did you mean 'pair-play-v1'")
    assert_refused(capsys, ["data", "show", "freight-play-10m-v1"], "hrl-escape data make freight-play-10m-v1")
    assert_refused(capsys, ["data", "make"], "at least one data set")
    assert_refused(capsys, ["data", "make", "pair-play-v1", "--primitives", "0"], "--primitives")
    assert_refused(capsys, ["data", "make", "mine", "--room", "paper-two-button"], "with both --room and --played")
    assert list(tmp_path.iterdir()) == []
