"""A planted bug, and the copy of the package in which it is planted."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

__all__ = ["ROOT", "Mutation", "PackageCopy", "find_source"]

ROOT = Path(__file__).parents[2]
"""Folder of the project."""
LIBRARIES = ("torch", "torchrl", "pybullet", "ompl", "pinocchio", "scipy.optimize", "scipy.stats", "gymnasium",
             "pytest", "matplotlib.pyplot", "hypothesis", "jinja2", "rich.table", "viser", "PIL.Image")
"""Loaded once; each mutant's tests begin in a fork of the process that has them, and load the package themselves."""

SEEN = (pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED)
"""A test failed, or its module could not even be loaded."""


class Mutation(NamedTuple):
    """One bug.

    Attributes:
        bug: what is wrong with it.
        file: path within `hrl_escape`, or of the project if it begins with `studies/`.
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
    return root / file if file.startswith("studies/") else root / "hrl_escape" / file


class PackageCopy:
    """A copy of the package and its tests, in which one file at a time is broken.

    Args:
        folder: where it is made; one that stands there is refreshed, its compiled kernels stay.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for name in ("hrl_escape", "studies", "tests", "examples", "docs", "benchmarks"):
            shutil.rmtree(folder / name, ignore_errors=True)
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        for path in ROOT.glob("*.*"):
            if path.is_file():
                shutil.copy2(path, folder)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(list(LIBRARIES))

    def is_seen(self, mutation: Mutation, seconds: float = 300.0) -> bool:
        """Plant a bug, run its tests, mend it; say whether one of them failed, or hung for so many seconds.

        Raises:
            RuntimeError: the tests could not be run, or the bug's place is not found.
        """
        sound = find_source(ROOT, mutation.file).read_text(encoding="utf-8")
        if sound.count(mutation.old) != 1:
            raise RuntimeError(f"{mutation.old!r} stands {sound.count(mutation.old)} times in {mutation.file}")
        changed = sound.replace(mutation.old, mutation.new)
        return self.is_change_seen(mutation.file, changed, mutation.tests.split(), seconds)

    def is_change_seen(self, file: str, changed: str, tests: Sequence[str], seconds: float = 300.0) -> bool:
        """The same for the whole changed text of a file."""
        path = find_source(self._folder, file)
        path.write_text(changed, encoding="utf-8")
        try:
            return self._run(tests, seconds)
        finally:
            path.unlink()
            shutil.copy2(find_source(ROOT, file), path)

    def _run(self, tests: Sequence[str], seconds: float) -> bool:
        process = self._context.Process(target=_run_pytest, args=(self._folder, tests))
        process.start()
        process.join(seconds)
        if process.is_alive():
            process.kill()
            process.join()
            return True
        if process.exitcode not in (pytest.ExitCode.OK, *SEEN):
            raise RuntimeError(f"the tests did not run:\n{(self._folder / 'output.txt').read_text()[-3000:]}")
        return process.exitcode in SEEN


def _run_pytest(folder: Path, tests: Sequence[str]) -> None:
    """Run tests of the copy in this process, which has not loaded the package yet."""
    assert "hrl_escape" not in sys.modules
    for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
        del sys.modules[name]
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    os.environ |= {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "kernels")}
    with open("output.txt", "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    places = [f"tests/{test}" for test in tests]
    sys.exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *places]))
