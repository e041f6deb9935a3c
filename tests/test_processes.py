"""Locks: one process at a time, and file systems that have none."""

import errno
import fcntl
from pathlib import Path

import pytest

from hrl_escape.processes import take_lock


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
