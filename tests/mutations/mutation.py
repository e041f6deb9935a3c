"""A planted bug, and the copy of the package in which it is planted."""

from __future__ import annotations

import ast
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from hrl_escape.kernels import find_cache_folder
from tests.forks import run_fork

__all__ = ["ROOT", "Mutation", "PackageCopy", "find_source", "plant"]

ROOT = Path(__file__).parents[2]
"""Folder of the project."""
PYTEST = """
import sys, pytest
code = 0
for marks in "not (nightly or gpu)", "nightly and not (slow or gpu)":
    code = code or pytest.main(["-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-m", marks, *sys.argv[1:]]) % 5
sys.exit(code)
"""
"""Fast tests first, then those of the nightly tier. Exit code 5 says that there is none of a kind."""
SEEN = (pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED, -signal.SIGXCPU, -signal.SIGSEGV, -signal.SIGABRT)
"""A test failed, its module could not even be loaded, it did not end, or the interpreter crashed."""
UNSEEN = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
"""All passed, or all were skipped."""


class Mutation(NamedTuple):
    """One bug.

    Attributes:
        bug: what is wrong with it.
        place: `FILE::NAME`: a path within `hrl_escape` (of the project if it begins with `studies/` or `benchmarks/`),
            and the qualified name of a function, a class or a constant in it, as `Replay.add`. A file that is not
            Python has no name.
        old: sound text, which occurs once in the definition of that name.
        new: text that takes its place.
        tests: modules or single tests, paths within `tests` separated by blanks; one of them must fail.
    """

    bug: str
    place: str
    old: str
    new: str
    tests: str

    @property
    def file(self) -> str:
        """Path of the file, as `find_source` takes it."""
        return self.place.partition("::")[0]


def find_source(root: Path, file: str) -> Path:
    """Where a mutation's file is in a copy of the project."""
    return root / file if file.startswith(("studies/", "benchmarks/")) else root / "hrl_escape" / file


def plant(mutation: Mutation, source: str) -> str:
    """Return the source of a file with the bug in it.

    Raises:
        LookupError: the file does not define the name, or its definition does not hold the old text exactly once.
    """
    file, _, name = mutation.place.partition("::")
    if not name and file.endswith(".py"):
        raise LookupError(f"{mutation.bug!r} names no function: write {file}::FUNCTION")
    spans = _find_definitions(source, name) if name else [(0, len(source))]
    if not spans:
        raise LookupError(f"{mutation.bug!r}: {file} does not define {name}")
    places = [start + place for start, end in spans for place in _find_all(source[start:end], mutation.old)]
    if len(places) != 1:
        raise LookupError(f"{mutation.bug!r}: the old text occurs {len(places)} times, not once, in {mutation.place}: "
                          f"{mutation.old!r}")
    return source[:places[0]] + mutation.new + source[places[0] + len(mutation.old):]


def _find_all(text: str, part: str) -> list[int]:
    return [place for place in range(len(text)) if text.startswith(part, place)]


def _find_definitions(source: str, name: str) -> list[tuple[int, int]]:
    """Spans of what defines a qualified name, in whole lines; a property and its setter are two."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = [ast.parse(source).body]
    *owners, last = name.split(".")
    for owner in owners:
        found = [node.body for body in found for node in _walk(body)
                 if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == owner]
    nodes = [node for body in found for node in _walk(body) if last in _list_names(node)]
    return [(starts[min(part.lineno for part in (node, *getattr(node, "decorator_list", ()))) - 1],
             starts[node.end_lineno or node.lineno]) for node in nodes]


def _walk(body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements of a scope, those below `if`, `try` and `with` among them."""
    for node in body:
        yield node
        if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            for part in ("body", "orelse", "finalbody"):
                yield from _walk(getattr(node, part, ()))


def _list_names(node: ast.stmt) -> list[str]:
    """Names that a statement defines."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


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
            LookupError: the bug's place is not found.
            RuntimeError: the tests could not be run.
        """
        changed = plant(mutation, find_source(ROOT, mutation.file).read_text(encoding="utf-8"))
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
