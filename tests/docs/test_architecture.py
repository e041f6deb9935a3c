"""The page on architecture names files and functions that there are, each where it says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/architecture.md"
PLACES = (ROOT / "hrl_escape", ROOT)


def find_faults(text: str) -> list[str]:
    """Paths in backticks that are no file or folder, and names before ` in the same file` or a path that it lacks."""
    faults, known = [], ""
    for word in re.findall(r"`([^`]+)`", text):
        if re.fullmatch(r"[a-z_\d]+(/[\w.-]+)+/?", word):
            found = [place / word for place in PLACES if (place / word).exists()]
            faults += [] if found else [f"{word} is no file"]
            known = "".join(path.read_text() for path in found if path.is_file())
        elif known and re.fullmatch(r"(_?compute|_?run|_?make|_?find)_\w+", word) and f"def {word}(" not in known:
            faults.append(f"{word} is not in the file named before it")
    return faults


def list_questions() -> list[str]:
    return re.findall(r"^\d+\. .*$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)


@pytest.mark.parametrize("question", list_questions(), ids=lambda question: question[:40])
def test_what_a_question_is_answered_with_is_there(question: str):
    assert find_faults(question) == []


def test_every_path_on_the_page_is_a_file_or_a_folder():
    faults = find_faults(PAGE.read_text(encoding="utf-8"))
    assert [fault for fault in faults if fault.endswith("no file")] == []


def test_the_ten_questions_are_ten_and_a_wrong_answer_is_found():
    assert len(list_questions()) == 10
    assert find_faults("`benchmark/nowhere.py`") == ["benchmark/nowhere.py is no file"]
    assert find_faults("`benchmark/statistics.py`, `compute_interval`") == [
        "compute_interval is not in the file named before it"]
