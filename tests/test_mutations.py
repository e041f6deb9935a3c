"""Planted bugs, one at a time in a copy of the package: each makes a test fail.

`tests/mutations/<package>.py` lists them. `make test-planted` runs them all, with `SHARD=2/4` a quarter; `python -m
pytest tests/test_mutations.py -m slow -k sets` runs those of one package.
"""

from __future__ import annotations

from importlib import import_module

import pytest

from tests.mutations.mutation import ROOT, Mutation, PackageCopy, find_source

PACKAGES = ("smdp_traps", "task_hierarchies", "learned", "env", "planning", "options", "agents", "sets",
            "comparison", "studies", "viewer", "commands", "text", "data")
MUTATIONS: dict[str, list[Mutation]] = {
    package: [Mutation(*fields) for fields in import_module(f"tests.mutations.{package}").MUTATIONS]
    for package in PACKAGES}
EVERY = [pytest.param(mutation, id=f"{package}: {mutation.bug}")
         for package, mutations in MUTATIONS.items() for mutation in mutations]


def test_every_bug_changes_one_place_and_names_tests_that_exist():
    for mutation in (mutation for mutations in MUTATIONS.values() for mutation in mutations):
        source = find_source(ROOT, mutation.file).read_text(encoding="utf-8")
        assert source.count(mutation.old) == 1, f"{mutation.bug}: {mutation.old!r} in {mutation.file}"
        assert mutation.new != mutation.old
        for test in mutation.tests.split():
            module, *name = test.partition("[")[0].split("::")
            text = (ROOT / "tests" / module).read_text(encoding="utf-8")
            assert not name or f"def {name[0]}(" in text, f"{mutation.bug}: no test {test}"


def test_every_package_has_bugs_of_its_own_and_each_is_listed_once():
    found = [(mutation.file, mutation.old, mutation.new) for package, mutations in MUTATIONS.items()
             for mutation in mutations if package not in ("smdp_traps", "task_hierarchies", "learned")]
    assert len(set(found)) == len(found)
    assert all(len(mutations) >= 10 for mutations in MUTATIONS.values())


SOUND = Mutation("none", "names.py", "LONGEST_FILE_NAME = 120", "LONGEST_FILE_NAME = 120  # as it was",
                 "test_names.py env/puzzles/test_buttons.py")


@pytest.fixture(scope="session")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Without a bug its tests pass, so what fails below fails for the bug."""
    copy = PackageCopy(tmp_path_factory.mktemp("copy"))
    assert not copy.is_seen(SOUND)
    return copy


@pytest.mark.slow
def test_no_bug_runs_with_the_bytecode_of_another_of_its_size(copy: PackageCopy, monkeypatch: pytest.MonkeyPatch):
    """Python takes a file for unchanged by its size and the whole second of its last change."""
    planted = find_source(copy.folder, "names.py")
    monkeypatch.setattr(copy, "_run", lambda tests, seconds: int(planted.stat().st_mtime))
    assert len({copy.is_change_seen("names.py", "", []) for _ in range(3)}) == 3


@pytest.mark.slow
@pytest.mark.parametrize("mutation", EVERY)
def test_a_planted_bug_is_seen(copy: PackageCopy, mutation: Mutation):
    assert copy.is_seen(mutation), f"no test of {mutation.tests} sees: {mutation.bug} ({mutation.file})"
