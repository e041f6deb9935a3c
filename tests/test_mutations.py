"""Planted bugs, one at a time in a copy of the package: each makes a test fail.

`tests/mutations/<package>.py` lists those of a package. `make test-nightly` plants them all; `pytest
tests/test_mutations.py -k sets` those of one package.
"""

from __future__ import annotations

from importlib import import_module

import pytest

from tests.mutations.mutation import ROOT, Mutation, PackageCopy, find_source, plant

PACKAGES = ("env", "planning", "options", "agents", "algorithms", "sets", "benchmark", "studies", "viewer",
            "commands", "text", "data")
MUTATIONS: dict[str, list[Mutation]] = {
    package: import_module(f"tests.mutations.{package}").MUTATIONS for package in PACKAGES}
EVERY = [pytest.param(mutation, id=f"{package}: {mutation.bug}")
         for package, mutations in MUTATIONS.items() for mutation in mutations]
MOST = 40
"""Planted bugs of a list: a new one that is more telling takes the place of another."""


def test_every_bug_changes_one_place_and_names_tests_that_exist():
    for mutation in (mutation for mutations in MUTATIONS.values() for mutation in mutations):
        source = find_source(ROOT, mutation.file).read_text(encoding="utf-8")
        assert plant(mutation, source) != source
        for test in mutation.tests.split():
            module, *name = test.partition("[")[0].split("::")
            text = (ROOT / "tests" / module).read_text(encoding="utf-8")
            assert not name or f"def {name[0]}(" in text, f"{mutation.bug}: no test {test}"


def test_every_package_has_bugs_of_its_own_and_each_is_listed_once():
    found = [(mutation.place, mutation.old, mutation.new) for mutations in MUTATIONS.values() for mutation in mutations]
    assert len(set(found)) == len(found)
    assert all(10 <= len(mutations) <= MOST for mutations in MUTATIONS.values())


SOURCE = """\
LIMIT = 1


class Queue:
    @property
    def size(self):
        return LIMIT

    @size.setter
    def size(self, value):
        if value:
            total = LIMIT + 1


def size():
    return LIMIT
"""


@pytest.mark.parametrize(("name", "old", "line"), [
    ("LIMIT", "1", 0), ("size", "LIMIT", 15), ("Queue.size", "LIMIT + 1", 11), ("Queue.size.total", "LIMIT", 11),
    ("Queue.size", "return LIMIT", 6)])
def test_a_bug_is_planted_in_the_definition_that_it_names(name: str, old: str, line: int):
    for lines_above in "", "# moved\n" * 3:
        planted = plant(Mutation("bug", f"queue.py::{name}", old, "0", ""), lines_above + SOURCE)
        changed = [number for number, (one, other) in enumerate(zip(
            planted.splitlines(), (lines_above + SOURCE).splitlines(), strict=True)) if one != other]
        assert changed == [line + lines_above.count("\n")]


@pytest.mark.parametrize(("place", "words"), [
    ("queue.py", "names no function"), ("queue.py::Stack", "queue.py does not define Stack"),
    ("queue.py::Queue.length", "does not define Queue.length"), ("queue.py::Queue", "occurs 2 times"),
    ("queue.py::size.nothing", "does not define")])
def test_a_place_that_is_not_found_is_an_error_that_says_which(place: str, words: str):
    with pytest.raises(LookupError, match="'a bug'") as error:
        plant(Mutation("a bug", place, "LIMIT", "0", ""), SOURCE)
    assert words in str(error.value)


SOUND = Mutation("none", "names.py::LONGEST_FILE_NAME", "= 120", "= 120  # as it was",
                 "test_names.py env/puzzles/test_buttons.py")


@pytest.fixture(scope="session")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Without a bug its tests pass, so what fails below fails for the bug."""
    copy = PackageCopy(tmp_path_factory.mktemp("copy"))
    assert not copy.is_seen(SOUND)
    return copy


@pytest.mark.nightly
def test_no_bug_runs_with_the_bytecode_of_another_of_its_size(copy: PackageCopy, monkeypatch: pytest.MonkeyPatch):
    """Python takes a file for unchanged by its size and the whole second of its last change."""
    planted = find_source(copy.folder, "names.py")
    monkeypatch.setattr(copy, "_run", lambda tests, seconds: int(planted.stat().st_mtime))
    assert len({copy.is_change_seen("names.py", "", []) for _ in range(3)}) == 3


@pytest.mark.nightly
@pytest.mark.parametrize("mutation", EVERY)
def test_a_planted_bug_is_seen(copy: PackageCopy, mutation: Mutation):
    assert copy.is_seen(mutation), f"no test of {mutation.tests} sees: {mutation.bug} ({mutation.place})"
