"""Files are whole or not there."""

import json
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.errors import FileReadError, FileWriteError
from hrl_escape.files import (
    DEEPEST,
    atomic_writer,
    make_folder,
    open_for_writing,
    read_bytes,
    read_json,
    read_text,
    read_toml,
    temporary_folder,
    write_bytes,
    write_json,
    write_text,
)
from studies.running import claim_folder
from tests.forks import run_fork

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
)


@pytest.mark.nightly
@given(value=JSON)
def test_json_comes_back_bit_for_bit(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("json") / "deep" / "x.json"
    write_json(path, value)
    assert repr(read_json(path)) == repr(value)


def test_json_refuses_what_json_cannot_hold(tmp_path):
    for value in (float("nan"), {1, 2}):
        with pytest.raises((ValueError, TypeError)):
            write_json(tmp_path / "x.json", value)
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "x.txt"
    write_text(path, "old")

    def write_half():
        with atomic_writer(path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert read_text(path) == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_files_have_ordinary_permissions(tmp_path):
    write_text(tmp_path / "atomic", "x")
    (tmp_path / "plain").write_text("x")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("atomic", "plain")}
    assert len(modes) == 1


@pytest.mark.nightly
def test_a_process_killed_while_writing_leaves_a_whole_file(tmp_path):
    path = tmp_path / "x.bin"
    code = (
        "import sys; from hrl_escape.files import write_bytes\n"
        "while True:\n  for b in b'ab': write_bytes(sys.argv[1], bytes([b]) * 3_000_000)"
    )
    for round_ in range(4):
        process = subprocess.Popen([sys.executable, "-c", code, path], cwd=Path(__file__).parents[1])
        while not path.exists():
            time.sleep(0.005)
        time.sleep(0.02 + 0.013 * round_)
        process.kill()
        process.wait()
        content = read_bytes(path)
        assert len(content) == 3_000_000 and len(set(content)) == 1
        path.unlink()


def test_content_is_on_the_disk_before_the_name_and_the_name_before_the_end(tmp_path, monkeypatch):
    events = []
    sync, replace = os.fsync, os.replace

    def note_sync(descriptor):
        events.append(("sync", os.fstat(descriptor).st_ino, os.fstat(descriptor).st_size))
        sync(descriptor)

    def note_replace(source, target):
        events.append(("replace", os.stat(source).st_ino, 0))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(os, "replace", note_replace)
    write_bytes(tmp_path / "x", b"12345")
    file, folder = os.stat(tmp_path / "x").st_ino, os.stat(tmp_path).st_ino
    assert [event[:2] for event in events] == [("sync", file), ("replace", file), ("sync", folder)]
    assert events[0][2] == 5, "flushed before it is synced"


def test_a_folder_in_the_way_is_named(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileWriteError, match=r"cannot write .*file/x\.json.*choose a writable folder"):
        write_json(tmp_path / "file" / "x.json", 1)
    with pytest.raises(FileWriteError, match="cannot write"):
        write_bytes(tmp_path, b"x")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(FileWriteError, match="Permission denied"):
        write_json(tmp_path / "x.json", 1)


def test_missing_broken_and_binary_files_are_told_apart(tmp_path):
    with pytest.raises(FileReadError, match=r"none\.json: no such room"):
        read_json(tmp_path / "none.json", "room")
    write_text(tmp_path / "cut.json", '{"a": [1,\n 2')
    with pytest.raises(FileReadError, match=r"truncated or not JSON: .* at line 2, column"):
        read_json(tmp_path / "cut.json")
    write_bytes(tmp_path / "binary.json", b"\xff\xfe\x00")
    with pytest.raises(FileReadError, match="not UTF-8"):
        read_json(tmp_path / "binary.json")
    with pytest.raises(FileReadError, match="cannot read this file: it is a folder, and only plain files are read"):
        read_bytes(tmp_path)


# --- extreme files ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/stdin", "/dev/full"])
def test_devices_are_refused_before_a_byte_is_read(name):
    with pytest.raises(FileReadError, match=f"{name}: cannot read this room: it is a device or a pipe"):
        read_json(name, "room")


def test_a_pipe_without_writer_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(FileReadError, match="only plain files are read"):
        read_toml(tmp_path / "fifo")


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with open(tmp_path / "huge.json", "wb") as file:
        file.truncate(10**13)
    with pytest.raises(FileReadError, match="has 10,000,000,000,000 bytes; at most 268,435,456"):
        read_json(tmp_path / "huge.json")


@pytest.mark.parametrize(("text", "words"), [
    ("[" * 200 + "]" * 200, "nested more than 100 levels deep"),
    ("[" * 10**6 + "]" * 10**6, "nested more than 100 levels deep"),
    ('{"a":' * 150 + "1" + "}" * 150, "nested more than 100 levels deep"),
    ("7" * 5_000, "a number of thousands of digits"),
    ('{"a": NaN}', "NaN is not a JSON number"),
    ("[-Infinity]", "-Infinity is not a JSON number"),
    ('{"a": -1e400}', "-1e400 is larger than every finite number"),
])
def test_extreme_json_is_refused_in_words(tmp_path, text, words):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(FileReadError, match=words):
        read_json(tmp_path / "x.json")


@pytest.mark.nightly
def test_json_of_more_values_than_memory_should_hold_is_refused_before_it_is_parsed(tmp_path):
    (tmp_path / "many.json").write_bytes(b"[" + b"{}," * (40 * 2**20 // 3) + b"{}]")
    program = f"""
import resource
from hrl_escape.files import read_json
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    read_json({str(tmp_path / "many.json")!r})
except Exception as error:
    print(type(error).__name__, "MiB of memory; at most 1,024 are read here" in str(error))
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10 < 200)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "FileReadError True\nTrue\n"
    rows = [{"kind": "episode", "primitives": n, "train/return": 0.5 * n, "train/success": 1} for n in range(50_000)]
    write_json(tmp_path / "long.json", rows)
    assert read_json(tmp_path / "long.json") == rows


def test_a_file_that_grows_is_never_written_through_a_link(tmp_path):
    (tmp_path / "target").write_text("mine")
    for name, target in (("link", "target"), ("dangling", "no-such-file")):
        (tmp_path / name).symlink_to(tmp_path / target)
        for mode in ("ab", "wb"):
            with pytest.raises(FileWriteError, match="it is a link. Choose the path of a plain file"):
                open_for_writing(tmp_path / name, mode)
    assert (tmp_path / "target").read_text() == "mine" and not (tmp_path / "no-such-file").exists()


@pytest.mark.parametrize(("text", "words"), [
    ("a = " + "[" * 200 + "]" * 200, "nested more than 100 levels deep"),
    ("a = " + "[" * 10**5 + "]" * 10**5, "nested more than 100 levels deep"),
    ("a = " + "7" * 5_000, "a number of thousands of digits"),
    ("a." * 20_000 + "a = 1", "nested more than 100 levels deep"),
    ("[" + "'a' . \"b\" ." * 10_000 + "a]", "nested more than 100 levels deep"),
    ("b = {" + "a." * 20_000 + "a = 1}", "nested more than 100 levels deep"),
    ("#" * 2**20 + "\n", "1,048,577 bytes; at most 1,048,576"),
])
def test_extreme_toml_is_refused_in_words(tmp_path, text, words):
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(FileReadError, match=words):
        read_toml(tmp_path / "x.toml")


def test_files_as_deep_as_allowed_are_read(tmp_path):
    (tmp_path / "x.toml").write_text("a." * (DEEPEST - 1) + "a = \"" + "two words. " * 200 + "\"")
    assert read_toml(tmp_path / "x.toml")
    write_json(tmp_path / "x.json", json.loads("[" * DEEPEST + "]" * DEEPEST))
    assert read_json(tmp_path / "x.json")


def test_a_name_as_long_as_the_system_allows_is_written_and_a_longer_one_refused(tmp_path):
    write_text(tmp_path / ("a" * 255), "x")
    with pytest.raises(FileWriteError, match="File name too long"):
        write_text(tmp_path / ("a" * 256), "x")
    with pytest.raises(FileReadError, match="File name too long"):
        read_text(tmp_path / ("a" * 256))


@pytest.mark.parametrize("write", [lambda path: write_json(path, 1), open_for_writing])
def test_what_is_no_plain_file_is_neither_replaced_nor_waited_for(tmp_path, write):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "folder").mkdir()
    for name, kind in (("pipe", "a device or a pipe"), ("link", "a device or a pipe"), ("folder", "a folder")):
        with pytest.raises(FileWriteError, match=f"{name}: it is {kind}"):
            write(tmp_path / name)
    assert stat.S_ISFIFO(os.lstat(tmp_path / "pipe").st_mode) and (tmp_path / "link").is_symlink()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("name", ["nul\0", "half\ud800", "nul\0/below", "half\ud800/below"])
def test_a_name_that_no_file_can_have_is_refused_in_words(tmp_path, name):
    for write in (lambda path: write_json(path, 1), open_for_writing, make_folder, claim_folder):
        with pytest.raises(FileWriteError, match="cannot write .*(null byte|surrogates)"):
            write(tmp_path / name)
    assert not list(tmp_path.iterdir())


FULL_TEMPORARY = """
import resource, gymnasium, hrl_escape
from hrl_escape.errors import FileWriteError
resource.setrlimit(resource.RLIMIT_FSIZE, (0, -1))
try:
    env = gymnasium.make("hrl_escape/ArmTwoButton-v1", render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
except FileWriteError as error:
    print(error)
"""


def test_a_full_disk_of_temporary_files_is_named():
    done = run_fork(FULL_TEMPORARY)
    assert done.stdout.startswith("cannot write the folder of temporary files (TMPDIR): No usable temp"), done.stderr


def test_a_temporary_folder_is_gone_after_the_block_and_an_error_of_ours_keeps_its_words():
    with pytest.raises(FileWriteError, match="^the video$"), temporary_folder() as folder:
        (folder / "x").write_text("x")
        raise FileWriteError("the video")
    assert not folder.exists()
    with pytest.raises(FileReadError, match="^the mesh$"), temporary_folder() as folder:
        raise FileReadError("the mesh")
    assert not folder.exists()
