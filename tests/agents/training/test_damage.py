"""Damaged files of a run end in one clear error, whatever the damage; they never pass as another run's."""

from __future__ import annotations

import io
import json
import math
import random
import shutil
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from hrl_escape.agents import load_agent, load_result, train
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.train import load_env
from hrl_escape.errors import CheckpointError, EscapeError, FileReadError, FileWriteError, RunMismatchError
from tests.agents.small_envs import ButtonGrid
from tests.forks import run_fork

FILES = ("run.json", "log.jsonl", "checkpoint.npz", "result.json")
STRANGE = (None, True, -1, 0.5, 10**400, "text", "", [], {}, [[1]], {"a": 1}, float("1e999"))


class Grid(ButtonGrid):
    """Grid that a run's folder can make again."""

    def __init__(self, horizon=30):
        super().__init__(horizon=horizon)
        self.horizon = horizon

    def describe(self):
        return {"horizon": self.horizon}


def run(out, agent="q-learning", **arguments):
    return train(agent, Grid(), out=out, **{"primitives": 150, "eval_every": 50, "eval_episodes": 1, "seed": 2,
                                            "checkpoint_seconds": 0} | arguments)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    run(folder)
    return folder


def change_bytes(content: bytes, chance: random.Random) -> bytes:
    """Content with one bit flipped, cut short, or with a piece taken out or doubled."""
    at, to = sorted(chance.sample(range(len(content)), 2))
    kind = chance.randrange(4)
    if kind == 0:
        return content[:at] + bytes([content[at] ^ (1 << chance.randrange(8))]) + content[at + 1:]
    return content[:at] if kind == 1 else content[:at] + content[to:] if kind == 2 else content[:to] + content[at:]


def change_value(value, chance: random.Random):
    """JSON value in which one part is strange or gone."""
    if isinstance(value, dict) and value and chance.random() < 0.9:
        name = chance.choice(list(value))
        if chance.random() < 0.2:
            return {key: part for key, part in value.items() if key != name}
        return {**value, name: change_value(value[name], chance)}
    if isinstance(value, list) and value and chance.random() < 0.9:
        at = chance.randrange(len(value))
        return [*value[:at], change_value(value[at], chance), *value[at + 1:]]
    return chance.choice(STRANGE)


def read_everything(folder):
    """Every way in which a run's folder is read."""
    for read in (load_result, load_env, load_agent, lambda path: load_agent(path, Grid()), run):
        try:
            read(folder)
        except EscapeError as error:
            assert str(error).strip() and len(str(error)) < 2_000


@pytest.mark.nightly_for("log.jsonl", "checkpoint.npz", "result.json")
@pytest.mark.parametrize("name", FILES)
def test_a_file_with_changed_bytes_is_read_or_refused_in_words(whole, tmp_path, name):
    chance = random.Random(name)
    for round_ in range(25):
        folder = tmp_path / str(round_)
        shutil.copytree(whole, folder)
        (folder / name).write_bytes(change_bytes((whole / name).read_bytes(), chance))
        if name == "log.jsonl" or chance.random() < 0.5:
            (folder / "result.json").unlink()  # so that the run is resumed
        read_everything(folder)


@pytest.mark.nightly_for("run.json", "log.jsonl", "result.json")
@pytest.mark.parametrize("name", FILES)
def test_a_file_with_values_of_another_kind_is_read_or_refused_in_words(whole, tmp_path, name):
    chance = random.Random(name)
    for round_ in range(25):
        folder = tmp_path / str(round_)
        shutil.copytree(whole, folder)
        if name == "checkpoint.npz":
            state = change_value(load_checkpoint(whole / name), chance)
            save_checkpoint(folder / name, state if isinstance(state, dict) else {"state": state})
        elif name == "log.jsonl":
            rows = [json.loads(line) for line in (whole / name).read_bytes().splitlines()]
            rows = [change_value(row, chance) if chance.random() < 0.3 else row for row in rows]
            (folder / name).write_text("".join(json.dumps(row) + "\n" for row in rows) + " " * 500)
        else:
            (folder / name).write_text(json.dumps(change_value(json.loads((whole / name).read_bytes()), chance)))
        if name != "result.json":
            (folder / "result.json").unlink()
        read_everything(folder)


@pytest.mark.parametrize(("field", "value"), [
    ("evaluations", 3), ("primitives", "many"), ("seconds", None), ("episodes", [{"length": 1}]), ("surplus", 1)])
def test_a_result_with_a_wrong_field_is_damaged(whole, tmp_path, field, value):
    content = json.loads((whole / "result.json").read_text())
    (tmp_path / "result.json").write_text(json.dumps({**content, field: value}))
    with pytest.raises(CheckpointError, match=rf"result\.json: this result of a run is damaged \(.*{field}"):
        load_result(tmp_path)


# --- archives ---------------------------------------------------------------------------


def write_archive(path: Path, members: dict[str, bytes], compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def make_npy(array) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def make_tree(tree) -> bytes:
    return make_npy(np.frombuffer(json.dumps(tree).encode(), np.uint8))


def test_an_array_that_claims_72_tebibytes_is_refused_before_memory_is_taken(tmp_path):
    file = io.BytesIO()
    npy.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (9_895_604_649_984,)})
    claims = file.getvalue() + bytes(512)
    path = write_archive(tmp_path / "x.npz", {"tree.npy": make_tree({"a": {"__array__": "b"}}), "b.npy": claims})
    with pytest.raises(CheckpointError, match=r"b\.npy has 512 bytes and claims 79,164,837,199,872"):
        load_checkpoint(path)


@pytest.mark.nightly
def test_a_compressed_archive_is_refused_before_it_unfolds(tmp_path):
    members = {"tree.npy": make_tree({"a": {"__array__": "b"}}), "b.npy": make_npy(np.zeros(10**7))}
    path = write_archive(tmp_path / "x.npz", members, zipfile.ZIP_DEFLATED)
    with pytest.raises(CheckpointError, match="compressed, which checkpoints are not"):
        load_checkpoint(path)


def test_one_array_cannot_be_claimed_a_million_times(tmp_path):
    tree = {"a": [{"__array__": "b"}] * 10**5}
    path = write_archive(tmp_path / "x.npz", {"tree.npy": make_tree(tree), "b.npy": make_npy(np.zeros(10**5))})
    with pytest.raises(CheckpointError, match=r"'b\.npy' is missing"):
        load_checkpoint(path)


def test_a_tree_of_millions_of_values_is_refused_before_it_is_parsed(tmp_path):
    tree = np.frombuffer(b'{"a":[' + b"{}," * (5 * 10**6) + b"{}]}", np.uint8)
    path = write_archive(tmp_path / "x.npz", {"tree.npy": make_npy(tree)})
    with pytest.raises(CheckpointError, match="MiB of memory; at most 1,024"):
        load_checkpoint(path)
    state = {"best": -math.inf, "mean": math.nan}
    save_checkpoint(path, state)
    assert str(load_checkpoint(path)) == str(state)


def test_an_archive_that_says_it_is_encrypted_is_refused(whole, tmp_path):
    content = bytearray((whole / "checkpoint.npz").read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = content.find(signature)
        while at >= 0:
            struct.pack_into("<H", content, at + offset, 1)
            at = content.find(signature, at + 1)
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(CheckpointError, match="encrypted"):
        load_checkpoint(tmp_path / "x.npz")


@pytest.mark.parametrize("tree", [[1], 3, "x", {"a": {"__array__": "../x"}}, {"a": {"__array__": [1]}}])
def test_a_tree_of_another_form_is_refused(tmp_path, tree):
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(write_archive(tmp_path / "x.npz", {"tree.npy": make_tree(tree)}))


# --- files of other runs ----------------------------------------------------------------


@pytest.mark.parametrize("name", ["result.json", "checkpoint.npz"])
def test_a_file_of_another_run_is_never_taken_for_this_ones(whole, tmp_path, name):
    run(tmp_path / "here", seed=5)
    shutil.copy(whole / name, tmp_path / "here" / name)
    with pytest.raises(CheckpointError, match=rf"{name} belongs to another run"):
        run(tmp_path / "here", seed=5)


@pytest.mark.parametrize(("name", "best"), [("checkpoint.npz", False), ("best.npz", True)])
def test_an_agent_of_another_run_is_never_loaded_as_this_ones(whole, tmp_path, name, best):
    """The two runs differ in their seed alone, so that the other's arrays would fit."""
    run(tmp_path / "here", seed=5)
    load_agent(tmp_path / "here", Grid(), best=best)
    shutil.copy(whole / name, tmp_path / "here" / name)
    for env in (Grid(), None):
        with pytest.raises(CheckpointError, match="the checkpoint belongs to another run"):
            load_agent(tmp_path / "here", env, best=best, trust=True)


@pytest.mark.parametrize("kept", ["result.json", "checkpoint.npz", "log.jsonl"])
def test_a_folder_without_its_description_is_not_adopted(whole, tmp_path, kept):
    shutil.copy(whole / kept, tmp_path / kept)
    with pytest.raises(CheckpointError, match=rf"{kept}: this folder is damaged: its run\.json is gone"):
        run(tmp_path)


def test_an_agent_given_as_an_object_is_told_from_one_of_another_seed_or_class(tmp_path):
    from hrl_escape.agents import make_agent

    def make(seed, name="dqn"):
        return make_agent(name, Grid().observation_space, Grid().action_space, seed, warmup=10**6)

    first = run(tmp_path / "run", make(0))
    assert run(tmp_path / "run", make(0)) == first
    with pytest.raises(RunMismatchError, match="agent_state: '.*' there, '.*' now"):
        run(tmp_path / "run", make(1))
    named = type("DQN", (type(make(0)),), {"__module__": "elsewhere"})
    other = named(Grid().observation_space, Grid().action_space, 0, make(0).settings)
    with pytest.raises(RunMismatchError, match="agent: '.*dqn:DQN' there, 'elsewhere:DQN' now"):
        run(tmp_path / "run", other)


def test_another_version_of_a_library_is_another_run(whole, tmp_path, monkeypatch):
    shutil.copytree(whole, tmp_path / "run")
    monkeypatch.setattr("hrl_escape.agents.training.run.find_versions", lambda: {"torch": "99"})
    with pytest.raises(RunMismatchError, match=r"versions\.torch: '.*' there, '99' now"):
        run(tmp_path / "run")


# --- disks ------------------------------------------------------------------------------


class Deleting(Grid):
    """Deletes, moves or empties the run's folder on the way."""

    def __init__(self, folder, how):
        super().__init__()
        self.folder, self.how, self.left = folder, how, 60

    def step(self, action):
        self.left -= 1
        if self.left == 0:
            shutil.rmtree(self.folder) if self.how == "folder" else None
            (self.folder / "log.jsonl").unlink() if self.how == "log" else None
            self.folder.rename(self.folder.with_name("moved")) if self.how == "moved" else None
        return super().step(action)


@pytest.mark.parametrize("how", ["folder", "log", "moved"])
def test_a_folder_that_vanishes_while_a_run_writes_it_is_told_at_once(tmp_path, how):
    folder = tmp_path / "run"
    with pytest.raises(FileWriteError, match=r"log\.jsonl was deleted or moved while its run was writing it"):
        train("q-learning", Deleting(folder, how), primitives=10**9, eval_episodes=0, out=folder)
    assert not (folder / "result.json").exists()


FULL = """
import resource, sys
from hrl_escape.agents import train
from hrl_escape.errors import FileWriteError
from tests.agents.small_envs import ButtonGrid
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000, 3_000))
try:
    train("q-learning", ButtonGrid(horizon=30), primitives=10**9, eval_episodes=0, out=sys.argv[1])
except FileWriteError as error:
    print(error)
"""


@pytest.mark.nightly
def test_a_full_disk_is_told_at_once_with_its_reason(tmp_path):
    """The limit on a file's size stands for a disk that fills up."""
    done = run_fork(FULL, tmp_path / "run", cwd=Path(__file__).parents[3])
    assert "log.jsonl: File too large. Free some space" in done.stdout and not done.stderr, done.stderr
    with pytest.raises(FileReadError):
        load_result(tmp_path / "run")


def test_what_a_killed_writer_left_is_cleared(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / ".writing-abc").write_bytes(b"half")
    run(tmp_path / "run")
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "best.npz", "checkpoint.npz", "lock", "log.jsonl", "result.json", "run.json"]
