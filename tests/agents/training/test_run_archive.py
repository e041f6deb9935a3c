"""Runs as archives: packed and unpacked to the same bytes; a thousand crafted ones write nothing but their folder."""

from __future__ import annotations

import io
import json
import os
import random
import stat
import struct
import zipfile

import numpy as np
import pytest

from hrl_escape.agents import load_agent, pack_run, read_summary, train, unpack_run
from hrl_escape.agents.training.checkpoint import load_checkpoint
from hrl_escape.agents.training.results import load_result
from hrl_escape.agents.training.run_folder import RunFolder, read_run
from hrl_escape.cli import main
from hrl_escape.errors import CheckpointError, EscapeError, FileReadError, FileWriteError, RunBusyError
from tests.agents.small_envs import ButtonGrid
from tests.crafted import craft


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "mine"
    train("q-learning", ButtonGrid(horizon=90), primitives=200, eval_every=100, eval_episodes=1, out=out)
    return out


@pytest.fixture(scope="module")
def archive(folder):
    pack_run(folder, folder.parent / "mine.zip")
    return (folder.parent / "mine.zip").read_bytes()


def read_folder(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "lock"}


def test_a_run_comes_back_to_the_byte_and_equal_runs_give_equal_archives(folder, archive, tmp_path):
    (tmp_path / "mine.zip").write_bytes(archive)
    summary = unpack_run(tmp_path / "mine.zip", tmp_path / "moved" / "here")
    assert read_folder(tmp_path / "moved" / "here") == read_folder(folder)
    assert pack_run(tmp_path / "moved" / "here", tmp_path / "again.zip") == summary == read_summary(folder)
    assert (tmp_path / "again.zip").read_bytes() == archive
    assert summary.is_finished and summary.key == json.loads((folder / "result.json").read_text())["key"]
    assert load_agent(tmp_path / "moved" / "here", ButtonGrid(horizon=90)).origin["run"] == summary.key
    assert stat.S_IMODE((tmp_path / "moved" / "here").stat().st_mode) == 0o755


@pytest.mark.nightly_for("torchrl-dqn")
@pytest.mark.parametrize("agent", ["dqn", "torchrl-dqn", "ppo"])
def test_a_frozen_run_acts_as_the_whole_one_and_holds_no_experience(agent, tmp_path):
    """Cut short in the middle of a rollout, and with a replay that is not empty."""
    def act(folder):
        rng, legal = np.random.default_rng(0), np.ones(7, np.bool_)
        loaded = load_agent(folder, ButtonGrid(horizon=90))
        return [loaded.act_greedy(np.array(state, np.float64), legal, rng) for state in np.ndindex(13, 13, 2, 2)]

    train(agent, ButtonGrid(horizon=90), primitives=300, eval_episodes=0, progress=False, out=tmp_path / "whole")
    pack_run(tmp_path / "whole", tmp_path / "whole.zip")
    pack_run(tmp_path / "whole", tmp_path / "frozen.zip", is_frozen=True)
    unpack_run(tmp_path / "frozen.zip", tmp_path / "frozen")
    state = load_checkpoint(tmp_path / "frozen" / "checkpoint.npz")["agent"]
    assert not state.get("rollout") and not state.get("replay", {}).get("added")
    assert (tmp_path / "frozen.zip").stat().st_size < (tmp_path / "whole.zip").stat().st_size
    assert load_result(tmp_path / "whole").episodes and not load_result(tmp_path / "frozen").episodes
    assert act(tmp_path / "frozen") == act(tmp_path / "whole")


def test_an_unpacked_run_goes_on_where_it_stopped(tmp_path):
    def go_on(out, primitives=400):
        return train("q-learning", ButtonGrid(horizon=90), primitives=primitives, eval_episodes=1, eval_every=100,
                     out=out, checkpoint_seconds=0)

    whole = go_on(tmp_path / "whole")
    (tmp_path / "whole" / "result.json").unlink()
    pack_run(tmp_path / "whole", tmp_path / "stopped.zip")
    assert not read_summary(tmp_path / "stopped.zip").is_finished
    unpack_run(tmp_path / "stopped.zip", tmp_path / "moved")
    assert go_on(tmp_path / "moved").evaluations == whole.evaluations


def test_a_run_in_training_is_not_packed(folder, tmp_path):
    running = RunFolder(folder, read_run(folder))
    try:
        with pytest.raises(RunBusyError):
            pack_run(folder, tmp_path / "mine.zip")
    finally:
        running.close()
    assert not (tmp_path / "mine.zip").exists()


def test_a_link_is_not_followed_into_an_archive(archive, tmp_path):
    (tmp_path / "mine.zip").write_bytes(archive)
    unpack_run(tmp_path / "mine.zip", tmp_path / "run")
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "run" / "log.jsonl").unlink()
    (tmp_path / "run" / "log.jsonl").symlink_to(tmp_path / "secret")
    with pytest.raises(FileReadError, match="log.jsonl: this is a link"):
        pack_run(tmp_path / "run", tmp_path / "leak.zip")
    assert not (tmp_path / "leak.zip").exists()


@pytest.mark.parametrize("there", ["folder", "file", "link"])
def test_nothing_that_is_there_is_written_over(archive, tmp_path, there):
    (tmp_path / "mine.zip").write_bytes(archive)
    target = tmp_path / "target"
    target.mkdir() if there == "folder" else target.write_text("mine") if there == "file" else target.symlink_to("no")
    with pytest.raises(FileWriteError, match="it is there already"):
        unpack_run(tmp_path / "mine.zip", target)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.zip", "target"]


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("count", [60, pytest.param(1_000, marks=pytest.mark.slow)])
def test_crafted_archives_write_nothing_outside_their_folder(folder, archive, tmp_path, monkeypatch, count):
    chance, whole = random.Random(38), read_folder(folder)
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    unpacked = 0
    for _ in range(count):
        (inner / "it.zip").write_bytes(craft(whole, archive, chance))
        try:
            unpack_run("it.zip", "out")
        except (CheckpointError, FileReadError) as error:
            assert str(error) and len(str(error)) < 1_000
            with pytest.raises(EscapeError):
                read_summary("it.zip")
            assert not os.path.lexists("out")
        else:
            unpacked += 1
            assert read_folder(inner / "out") == whole, "what a changed byte in the zip's own words leaves as it is"
            assert read_summary("it.zip").parts == read_summary("out").parts
            for path in (inner / "out").iterdir():
                assert path.is_file() and not path.is_symlink()
                path.unlink()
            (inner / "out").rmdir()
        assert [path.name for path in inner.iterdir()] == ["it.zip"]
    assert {path.name for path in tmp_path.rglob("*")} == {"a", "b", "it.zip"}
    assert unpacked < count / 10


@pytest.mark.nightly
def test_a_long_list_of_members_is_refused_before_it_is_read(archive, tmp_path):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as many:
        for number in range(70_000):  # as many as take the zip's extension to 64 bits
            many.writestr(zipfile.ZipInfo(str(number)), b"")
    (tmp_path / "many.zip").write_bytes(file.getvalue())
    with pytest.raises(CheckpointError, match="its list of members has"):
        unpack_run(tmp_path / "many.zip", tmp_path / "out")
    (tmp_path / "comment.zip").write_bytes(archive[:-2] + struct.pack("<H", 3) + b"PK?")
    with pytest.raises(CheckpointError, match="does not end as a zip does"):
        unpack_run(tmp_path / "comment.zip", tmp_path / "out")


def test_the_commands_pack_show_and_unpack(folder, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "pack", str(folder)]) == 0
    assert main(["run", "show", "mine.zip"]) == 0
    shown = capfd.readouterr().out
    assert "q-learning" in shown and "tests.agents.small_envs:ButtonGrid" in shown and "checkpoint.npz" in shown
    assert main(["run", "show", str(folder), "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["needs_trust"] == ["tests.agents.small_envs:ButtonGrid"] and report["finished"]
    assert main(["run", "unpack", "mine.zip"]) == 0
    assert read_folder(tmp_path / "mine") == read_folder(folder)
    assert main(["run", "unpack", "mine.zip"]) == 2
    assert "it is there already" in capfd.readouterr().err
