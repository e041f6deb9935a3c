"""Opening drivers: damaged runs, wrong names, runs of another room."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hrl_escape.cli import main
from hrl_escape.errors import CheckpointError, FileReadError, RunMismatchError, UnknownNameError
from hrl_escape.viewer.watch.drivers import open_driver


def copy(run: Path, to: Path) -> Path:
    to.mkdir()
    for file in run.iterdir():
        if file.is_file():
            (to / file.name).write_bytes(file.read_bytes())
    return to


def test_a_corrupt_checkpoint_gives_one_message(run: Path, two_buttons, tmp_path: Path, capfd):
    folder = copy(run, tmp_path / "run")
    content = (folder / "checkpoint.npz").read_bytes()
    (folder / "checkpoint.npz").write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        open_driver(str(folder), two_buttons)
    assert main(["watch", str(folder), "--no-open", "--port", "0"]) == 2
    assert len(capfd.readouterr().err.strip().splitlines()) == 1


def test_a_folder_that_is_no_run_and_a_name_that_is_no_agent(two_buttons, tmp_path: Path):
    with pytest.raises(FileReadError, match="run.json"):
        open_driver(str(tmp_path), two_buttons)
    with pytest.raises(FileReadError, match="no such run"):
        open_driver("runs/none", two_buttons)
    with pytest.raises(UnknownNameError, match="smdp-dqn"):
        open_driver("smdp-dqm", two_buttons)
    (tmp_path / "run.json").write_text(json.dumps([1]))
    with pytest.raises(CheckpointError, match="not the description of a run"):
        open_driver(str(tmp_path), two_buttons)


def test_a_label_opens_the_agent_in_the_environment_that_it_needs(one_button):
    driver = open_driver("smdp-dqn+objects+memory", one_button)
    assert driver.name == "smdp-dqn+objects+memory, learning" and driver.primitives == 0
    assert "failed" in driver.env.observation_space.words and driver.agent.settings.network == "objects"
    driver.env.close()
    assert open_driver("search-backtrack", one_button).name == "search-backtrack"


def test_a_run_of_another_room_is_refused_with_the_way_out(run: Path, clutter):
    with pytest.raises(RunMismatchError, match="leave out --room"):
        open_driver(str(run), clutter)
