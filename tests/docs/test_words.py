"""The check of words finds what it names, and the checked folders pass it."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("check_words")


def run(words: ModuleType, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["check_words.py", *arguments])
    return words.main()


@pytest.mark.nightly
def test_checked_folders_pass(words: ModuleType, monkeypatch: pytest.MonkeyPatch):
    assert all(words.list_files(place) for place in words.CHECKED)
    assert run(words, monkeypatch) == 0


@pytest.mark.parametrize(("text", "count"), [
    ("The file knows its twin, made anew beside the schematic.", 5),
    ("Returns the number of rooms, compared with the search baseline.", 0),
    ("Code in a line, `told=beside`, and links [here](told/beside.md) are left out.", 0),
    ("```python\ntape = 'anew'\n```\n", 0),
    ("```{figure} told.svg\nA caption that tells.\n```\nand a searcher\n", 2),
])
def test_words_are_counted_in_prose(words: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str,
                                    count: int):
    (tmp_path / "page.md").write_text(text)
    monkeypatch.setattr(words, "ROOT", tmp_path)
    assert len(words.check_place("page.md")[1]) == count


def test_docstrings_and_comments_are_read_and_code_is_not(
        words: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "module.py").write_text('"""Tells what is beside the room, in some more words than eight."""\n'
                                        "told = 1  # anew\n")
    monkeypatch.setattr(words, "ROOT", tmp_path)
    monkeypatch.setattr(words, "CHECKED", ("module.py",))
    assert len(words.check_place("module.py")[1]) == 3
    assert run(words, monkeypatch) == 1
    assert "module.py:2: 'anew'" in capsys.readouterr().out
