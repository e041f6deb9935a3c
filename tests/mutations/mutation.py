"""A planted bug, and the copy of the package in which it is planted."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from hrl_escape.kernels import find_cache_folder
from tests.forks import run_fork

__all__ = ["ROOT", "Mutation", "PackageCopy", "find_source"]

ROOT = Path(__file__).parents[2]
"""Folder of the project."""
PYTEST = """
import sys, pytest
sys.exit(pytest.main(["-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-m", "not (slow or in_turn)", *sys.argv[1:]]))
"""
SEEN = (pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED, -signal.SIGXCPU, -signal.SIGSEGV, -signal.SIGABRT)
"""A test failed, its module could not even be loaded, it did not end, or the interpreter crashed."""
UNSEEN = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
"""All passed, or all were skipped."""


class Mutation(NamedTuple):
    """One bug.

    Attributes:
        bug: what is wrong with it.
        file: path within `hrl_escape`, or of the project if it begins with `studies/` or `benchmarks/`.
        old: sound text, which occurs once in the file.
        new: text that takes its place.
        tests: modules or single tests, paths within `tests` separated by blanks; one of them must fail.
    """

    bug: str
    file: str
    old: str
    new: str
    tests: str


def find_source(root: Path, file: str) -> Path:
    """Where a mutation's file is in a copy of the project."""
    return root / file if file.startswith(("studies/", "benchmarks/")) else root / "hrl_escape" / file


class PackageCopy:
    """A copy of the package and its tests, in which one file at a time is broken.

    It begins with the kernels that the package has compiled, and keeps its own: what is broken is compiled anew.

    Args:
        folder: where it is made; one that stands there is refreshed, its compiled kernels stay.

    Attributes:
        folder: where it is.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._planted = 0
        for name in ("hrl_escape", "studies", "tests", "examples", "docs", "benchmarks"):
            shutil.rmtree(folder / name, ignore_errors=True)
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        for path in ROOT.glob("*.*"):
            if path.is_file():
                shutil.copy2(path, folder)
        kernels = find_cache_folder()
        shutil.copytree(kernels, folder / "kernels" / "hrl_escape" / kernels.name, dirs_exist_ok=True)

    def is_seen(self, mutation: Mutation, seconds: int = 300) -> bool:
        """Plant a bug, run its tests, mend it; say whether one of them failed, or ran for so many processor seconds.

        Raises:
            RuntimeError: the tests could not be run, or the bug's place is not found.
        """
        sound = find_source(ROOT, mutation.file).read_text(encoding="utf-8")
        if sound.count(mutation.old) != 1:
            raise RuntimeError(f"{mutation.old!r} stands {sound.count(mutation.old)} times in {mutation.file}")
        changed = sound.replace(mutation.old, mutation.new)
        return self.is_change_seen(mutation.file, changed, mutation.tests.split(), seconds)

    def is_change_seen(self, file: str, changed: str, tests: Sequence[str], seconds: int = 300) -> bool:
        """The same for the whole changed text of a file."""
        path = find_source(self.folder, file)
        path.write_text(changed, encoding="utf-8")
        self._planted = max(self._planted + 1, int(time.time()))  # bytecode is known by the second and the size
        os.utime(path, (self._planted, self._planted))
        try:
            return self._run(tests, seconds)
        finally:
            path.unlink()
            shutil.copy2(find_source(ROOT, file), path)

    def _run(self, tests: Sequence[str], seconds: int) -> bool:
        places = [f"tests/{test}" for test in tests]
        environment = os.environ | {"PYTHONPATH": str(self.folder), "NUMBA_CACHE_DIR": str(self.folder / "kernels"),
                                    "CI": "1"}  # the same drawn examples every time
        try:
            done = run_fork(PYTEST, *places, cwd=self.folder, environment=environment, processor_seconds=seconds,
                            timeout=10 * seconds)
        except subprocess.TimeoutExpired:
            return True
        if done.returncode not in (*UNSEEN, *SEEN):
            raise RuntimeError(f"the tests did not run:\n{(done.stdout + done.stderr)[-3000:]}")
        return done.returncode in SEEN
