"""Names of rooms on the command line: a console shows them as they stand, and no file leaves its folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hrl_escape.cli import main

HOSTILE = ["[/bold]", "[bold red]", "\x1b[31mred", "../../up", "a/b", "x" * 300, "line\nbreak", "nul\0", "\u202e"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    return inner


def write_room(folder: Path, name: str) -> str:
    """File of a small room configuration with a name."""
    (folder / "room.json").write_text(json.dumps({"name": name, "puzzle": {"kind": "buttons", "count": 1},
                                                  "room": {"width": 8, "depth": 8}}))
    return "room.json"


@pytest.mark.parametrize("name", HOSTILE)
def test_a_rooms_name_is_shown_as_it_stands(folder: Path, name: str, capfd):
    code = main(["room", "--room", write_room(folder, name)])
    said = capfd.readouterr()
    assert (code, said.err) == (0, "") or code == 2 and len(said.err.splitlines()) == 1
    assert all(line.isprintable() for line in (said.out + said.err).splitlines())
    if name.startswith("["):
        assert name in said.out


@pytest.mark.nightly_for("name1", "../../up")
@pytest.mark.parametrize("name", ["../../up", "x" * 300])
def test_train_keeps_its_default_folder_below_runs(folder: Path, name: str, capfd):
    code = main(["train", "random", "--primitives", "5", "--eval-episodes", "0", "--room", write_room(folder, name)])
    said = capfd.readouterr()
    assert code == 0, said.err
    assert len(list((folder / "runs").iterdir())) == 1
    assert {path.name for path in folder.iterdir()} == {"room.json", "runs"}
    assert [path.name for path in folder.parent.iterdir()] == ["b"]


@pytest.mark.nightly_for("../../up")
@pytest.mark.parametrize("name", ["[/bold]", "../../up"])
def test_solve_and_record_show_names_as_they_stand(folder: Path, name: str, capfd):
    room = write_room(folder, name)
    assert main(["solve", "--room", room, "--draw", "[map]/way.svg"]) == 0
    said = capfd.readouterr().out
    assert name in said and "[map]" in said
    assert main(["record", "--room", room, "--out", "[page]/way.html"]) == 0
    assert "[page]" in capfd.readouterr().out
