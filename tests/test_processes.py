"""Locks: one process at a time, and file systems that have none."""

import errno
import fcntl
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hrl_escape.processes import take_lock, taking_turns
from tests.forks import run_fork


def test_a_lock_has_one_holder_and_is_free_again_once_it_is_closed(tmp_path: Path):
    with open(tmp_path / "lock", "ab") as mine:
        assert take_lock(mine)
        with open(tmp_path / "lock", "ab") as other:
            assert not take_lock(other)
    with open(tmp_path / "lock", "ab") as other:
        assert take_lock(other)


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_told_from_a_busy_one(tmp_path: Path, monkeypatch, number: int):
    def refuse(file, operation):
        raise OSError(number, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with open(tmp_path / "lock", "ab") as lock, pytest.warns(RuntimeWarning, match="no locks here"):
        assert take_lock(lock)


COUNT = """
import sys, time
from pathlib import Path
from hrl_escape.processes import taking_turns
path = Path(sys.argv[1]) / "count"
for _ in range(50):
    with taking_turns(path.parent):
        before = int(path.read_text()) if path.exists() else 0
        time.sleep(0.001)
        path.write_text(str(before + 1))
"""


def test_processes_that_take_turns_lose_nothing_of_each_other(tmp_path: Path):
    folder = tmp_path / "new"
    with ThreadPoolExecutor() as pool:
        both = [pool.submit(run_fork, COUNT, folder) for _ in range(2)]
    assert [each.result().returncode for each in both] == [0, 0]
    assert (folder / "count").read_text() == "100" and [path.name for path in folder.iterdir()] == ["count"]


def test_a_turn_ends_with_an_error(tmp_path: Path):
    with pytest.raises(KeyError), taking_turns(tmp_path):
        raise KeyError
    with taking_turns(tmp_path):
        pass
