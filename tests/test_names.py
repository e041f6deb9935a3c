"""Names made safe: what a file is called and what a console shows, whatever a name holds."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rich.console import Console

from hrl_escape.names import (
    LONGEST_FILE_NAME,
    count_nouns,
    join_words,
    make_console_text,
    make_file_name,
    parse_whole,
    tell_seconds,
)

HOSTILE = ["../../etc/passwd", "..", ".", "", "a/b", "a\\b", "nul\0", "line\nbreak", "x" * 300, "\N{SNOWMAN}" * 300,
           "[/bold]", "[bold", "\x1b[31mred", "\ud800", ".hidden", "C:\\x", "trailing\\"]


@pytest.mark.parametrize("name", ["paper-two-button", "dqn@patient", "a_b+c#1", "\N{GREEK SMALL LETTER GAMMA}-room"])
def test_a_plain_name_is_its_own_file_name(name: str):
    assert make_file_name(name) == name


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_stays_in_its_folder(name: str, tmp_path: Path):
    made = make_file_name(name)
    path = tmp_path / f"{made}.json"
    path.write_text("x")
    assert path.resolve().parent == tmp_path.resolve() and list(tmp_path.iterdir()) == [path]
    assert not made.startswith(".") and len(made.encode()) <= LONGEST_FILE_NAME


@given(st.lists(st.text(), min_size=2, max_size=2, unique=True))
@example(["a/b", "a?b"])
def test_different_names_have_different_files(names: list[str]):
    assert make_file_name(names[0]) != make_file_name(names[1])


@given(st.text())
def test_a_console_shows_one_line_without_control_characters(name: str):
    out = io.StringIO()
    Console(file=out, soft_wrap=True, force_terminal=False).print(f"[bold]{make_console_text(name)}[/bold] ends")
    said = out.getvalue()
    assert said.endswith(" ends\n") and said[:-1].isprintable() and len(said) < 1100


@pytest.mark.parametrize("name", ["[/bold]", "[link=http://x]y[/link]", "[bold]b"])
def test_markup_is_shown_as_it_stands(name: str):
    out = io.StringIO()
    Console(file=out, soft_wrap=True).print(make_console_text(name))
    assert out.getvalue() == f"{name}\n"


def test_a_long_name_is_cut_for_the_console():
    assert make_console_text("x" * 100) == "x" * 100
    assert make_console_text("x" * 101) == "x" * 97 + "..."


@pytest.mark.parametrize(("text", "number"), [
    ("0", 0), ("007", 7), ("9" * 18, 10**18 - 1), ("9" * 19, None), ("9" * 5_000, None), ("-1", None), ("", None),
    ("1.0", None), ("\u00b2", None), ("\u0663", None), ("1_0", None), (" 1", None), ("1\n", None)])
def test_a_number_in_a_name_is_of_plain_digits(text: str, number: int | None):
    assert parse_whole(text) == number


@pytest.mark.parametrize(("words", "text"),
                         [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")])
def test_words_are_listed_as_in_a_sentence(words: list[str], text: str):
    assert join_words(words) == join_words(iter(words)) == text
    assert join_words(["a", "b"], "or") == "a or b"


def test_nouns_are_counted_in_figures():
    assert [count_nouns(number, "room") for number in (0, 1, 1_000)] == ["0 rooms", "1 room", "1,000 rooms"]


@pytest.mark.parametrize(("seconds", "text"), [
    (3.21, "3.2 s"), (9.97, "10 s"), (89.4, "89 s"), (89.6, "1 min"), (95.0, "2 min"), (5_340.0, "89 min"),
    (5_400.0, "1 h 30 min"), (360_000.0, "100 h 0 min")])
def test_durations_are_told_with_their_unit(seconds: float, text: str):
    assert tell_seconds(seconds) == text
