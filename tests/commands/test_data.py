"""`hrl-escape data`: record, list, show and export a data set, as a user would."""

import json

import numpy as np
import pytest

from hrl_escape.data.catalogue import TAPE_KINDS
from hrl_escape.data.materialise import load_data
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
    assert set(rows) == {f"pair-{kind}-v1" for kind in TAPE_KINDS} | {NAME}
    assert "legal options, drawn uniformly" in call(capsys, "data", "list")[1]
    card = json.loads(call(capsys, "data", "show", NAME, "--json", "--draw", "card.svg")[1])
    tape = load_data(NAME, observation="features").tape
    assert card["primitives"] == len(tape.action) >= 1_000 and card["decisions"] == len(tape.option)
    assert card["made_by"] == f"hrl-escape data make {NAME}" and card["digest"] == tape.digest
    assert card["scores"]["chance"] < card["scores"]["best_known"]
    assert (folder / "card.svg").read_bytes().startswith(b"<?xml")
    assert tape.digest in call(capsys, "data", "show", str(path))[1]


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
    assert_refused(capsys, ["data", "make", "mine", "--rooms", "paper-two-button#0"], "with both --rooms and --played")
    assert list(tmp_path.iterdir()) == []
