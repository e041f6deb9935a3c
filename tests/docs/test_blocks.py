"""Every command and code block of the README and the site runs."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
import tyro

from hrl_escape.cli import main
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from studies.running import get_args
from studies.study import find_study
from tests.docs.blocks import PAGES, ROOT, Block, parse, parse_options, read_blocks, read_commands

BLOCKS = {page: read_blocks(page) for page in PAGES}
KNOWN = {"python", "console", "bibtex", "text", "toml", "json"}


def name_page(page: Path) -> str:
    return str(page.relative_to(ROOT))


def pages_with(language: str) -> list[Path]:
    return [page for page, blocks in BLOCKS.items() if any(block.language == language for block in blocks)]


@pytest.mark.parametrize("page", pages_with("python"), ids=name_page)
def test_python_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A page's blocks in order, as one program."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    for block in BLOCKS[page]:
        if block.language == "python":
            program = compile(block.text, name_page(page), "exec")
            if not block.is_parsed_only:
                exec(program, names)


@pytest.mark.parametrize("page", pages_with("console"), ids=name_page)
def test_commands_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    for block in BLOCKS[page]:
        if block.language == "console":
            for words in read_commands(block):
                run(block, words)


def run(block: Block, words: list[str]) -> None:
    program, *arguments = words
    if program == "hrl-escape":
        if block.is_parsed_only:
            parse(arguments)
        else:
            assert main(arguments) == 0, words
    elif program == "make":
        assert re.search(rf"^{arguments[0]}:", (ROOT / "Makefile").read_text(), re.M), words
    elif program == "source":
        assert arguments == [f"{read_environment()}/bin/activate"]
    elif words[:3] == ["python3", "-m", "venv"]:
        assert arguments[2:] == [read_environment()]
    elif program == "pip":
        extras = re.findall(r"\.\[([\w,]+)\]", " ".join(arguments))
        listed = (ROOT / "pyproject.toml").read_text()
        assert all(re.search(rf"^{extra} = \[", listed, re.M) for part in extras for extra in part.split(",")), words
    elif words[:2] == ["python", "-m"] and arguments[1].startswith("benchmarks."):
        parse_options(arguments[1], arguments[2:])
    elif words[:3] == ["python", "-m", "studies"]:
        tyro.cli(get_args(find_study(arguments[2])), args=arguments[3:], config=(tyro.conf.FlagCreatePairsOff,))
    elif program in ("python", "pytest", "sphinx-build"):  # scripts have tests of their own
        paths = [word for word in arguments if "/" in word and not word.startswith(("-", "build/", "runs/"))]
        assert paths and all((ROOT / path).exists() for path in paths), words
    else:
        raise AssertionError(f"{block.page}: who tests {' '.join(words)}?")


def read_environment() -> str:
    """Folder of the environment that the Makefile makes."""
    return re.search(r"^VENV +:= (.+)$", (ROOT / "Makefile").read_text(), re.M)[1]


def test_every_block_is_of_a_kind_that_is_tested_or_only_shown():
    unknown = {block.language for blocks in BLOCKS.values() for block in blocks} - KNOWN
    assert not unknown


def test_a_wrong_argument_is_found():
    with pytest.raises(SystemExit):
        parse(["room", "--prest", "clutter"])
    with pytest.raises(KeyError):
        parse(["ladder", "nothing"])


def test_a_replacement_that_fits_nothing_is_found(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("<!-- tests: 20_000 -> 500 -->\n```python\ntrain(primitives=30_000)\n```\n")
    with pytest.raises(AssertionError, match="20_000"):
        read_blocks(page)


@pytest.mark.slow  # `make docs` draws the whole
def test_the_strip_of_the_first_page_is_what_the_planner_does(monkeypatch: pytest.MonkeyPatch):
    """Its four cards by the planner, drawn anew."""
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    strip = importlib.import_module("strip")
    kept = strip.KEPT.read_text(encoding="utf-8")
    longest = max(map(int, re.findall(r">out in (\d+)<", kept)))
    planner = strip.Scene("The planner", "knows which button needs which",
                          (strip.solve(generate(get_preset("clutter"), strip.SEED)),))
    places = [(2, 0), (0, 1), (1, 1), (2, 1)]  # column, row
    for scene, (column, row) in zip([planner, *strip.make_others()], places, strict=True):
        assert strip.draw_card(scene, column, row, longest) in kept, scene.title


def test_the_first_page_shows_the_strip_and_one_table_and_loads_fast():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "docs/images/strip.svg" in readme and readme.count("\n|---|") == 1, "one table"
    shown = [ROOT / path for path in re.findall(r"!\[[^\]]*\]\((docs/\S+)\)", readme)]
    assert sum(path.stat().st_size for path in shown) < 3e6
