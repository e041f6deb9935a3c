"""Every command and code block of the README and the site runs."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tomllib
import tyro
from PIL import Image

from hrl_escape.cli import main
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from studies.publishing import list_pages
from studies.running import get_args
from studies.study import find_study
from tests.docs.blocks import PAGES, ROOT, Block, parse, parse_options, read_blocks, read_commands

BLOCKS = {page: read_blocks(page) for page in PAGES}
KNOWN = {"python", "console", "bibtex", "text", "toml", "json"}


def name_page(page: Path) -> str:
    return str(page.relative_to(ROOT))


def pages_with(language: str) -> list[Path]:
    return [page for page, blocks in BLOCKS.items() if any(block.language == language for block in blocks)]


@pytest.mark.nightly_for(
    "docs/agents/dac.md", "docs/agents/hac.md", "docs/agents/hiro.md", "docs/agents/ppo.md", "docs/agents/sac.md",
    "docs/agents/td3.md", "docs/cookbook.md",
    "docs/data.md", "docs/extend/robot.md", "docs/hierarchies.md", "docs/ladder.md", "docs/metrics.md",
    "docs/observations.md", "docs/options.md", "docs/planning/arm.md", "docs/planning/robots.md",
    "docs/planning/trajectories.md", "docs/reproducibility.md", "docs/third_party.md")
@pytest.mark.parametrize("page", pages_with("python"), ids=name_page)
def test_python_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A page's blocks in order, as one program."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    for block in BLOCKS[page]:
        if block.language == "python":
            program = compile(block.text, name_page(page), "exec", dont_inherit=True)
            if not block.is_parsed_only:
                exec(program, names)


@pytest.mark.nightly_for(
    "docs/agents/a2oc.md", "docs/agents/dac.md", "docs/agents/ddpg.md", "docs/agents/deep-abstract-q.md",
    "docs/agents/diayn.md", "docs/agents/feudal-rl.md", "docs/agents/fun.md", "docs/agents/hac-finite.md",
    "docs/agents/hiro-finite.md", "docs/agents/hiro.md", "docs/agents/hrac-finite.md", "docs/agents/hrac.md",
    "docs/agents/index.md", "docs/agents/intra-option-q.md", "docs/agents/met-r-max.md", "docs/agents/offline.md",
    "docs/agents/option-keyboard.md", "docs/agents/ppoc.md", "docs/agents/r-maxq.md", "docs/agents/rainbow.md",
    "docs/agents/sac.md", "docs/agents/sarsa.md", "docs/agents/sol.md", "docs/agents/td3.md",
    "docs/agents/torchrl-dqn.md", "docs/agents/torchrl-ppo.md", "docs/agents/torchrl-sac.md", "docs/data.md",
    "docs/hierarchies.md", "docs/ladder.md", "docs/planners.md", "docs/viewer.md")
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
    elif words[:4] == ["python", "-m", "studies", "pages"]:
        assert set(arguments[3:]) <= set(list_pages()), words
    elif words[:3] == ["python", "-m", "studies"]:
        tyro.cli(get_args(find_study(arguments[2])), args=arguments[3:], config=(tyro.conf.FlagCreatePairsOff,))
    elif program in ("uvx", "openenv"):  # not installed here
        assert block.is_parsed_only, words
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


def test_commands_in_the_table_of_the_command_line_parse():
    table = (ROOT / "docs/cli.md").read_text(encoding="utf-8").partition("\n\n[")[0]
    commands = re.findall(r"`hrl-escape ([^`]+)`", table)
    assert len(commands) > 10
    for command in commands:
        parse(shlex.split(command))


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


def list_pictures(readme: str) -> set[Path]:
    """Files that the README shows."""
    return {ROOT / path for path in re.findall(r"(?:src|srcset)=\"(docs/[^\"]+)\"|!\[[^\]]*\]\((docs/\S+)\)", readme)
            for path in path if path}


def test_the_first_page_moves_has_one_table_and_loads_fast():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count("\n|---|") == 1
    pictures = list_pictures(readme)
    assert len(pictures) == 3 and sum(path.stat().st_size for path in pictures) < 1.5e6
    moving = Image.open(ROOT / "docs/images/escape.webp")
    assert ROOT / "docs/images/escape.webp" in pictures and getattr(moving, "n_frames") > 100  # noqa: B009  # no type


@pytest.mark.slow  # Bullet's software renderer takes a second a picture
def test_the_moving_picture_is_what_its_script_draws(monkeypatch: pytest.MonkeyPatch):
    """Its first picture, one in the middle and its last."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    script = importlib.import_module("make_picture")
    room = generate(script.ROOM, script.SEED)
    states = script.list_states(room, script.BETWEEN)
    kept = Image.open(script.KEPT)
    assert getattr(kept, "n_frames") == len(states)  # noqa: B009  # no type
    for number in (0, len(states) // 2, len(states) - 1):
        (drawn,) = script.take_pictures(room, [states[number]])
        kept.seek(number)
        assert np.abs(np.asarray(kept.convert("RGBA"), int) - np.asarray(drawn, int)).mean() < 4


@pytest.mark.slow  # trains for half a minute
def test_the_first_page_prints_what_it_shows(capsys: pytest.CaptureFixture[str]):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    program, printed = re.findall(r"```python\n(.+?)```\n\n```text\n(.+?)```", readme, re.S)[0]
    assert len(program.strip().splitlines()) <= 10
    exec(compile(program, "README.md", "exec", dont_inherit=True), {"__name__": "page"})
    assert printed in capsys.readouterr().out


def test_every_page_recommends_the_same_agents():
    pages = [ROOT / page for page in ("README.md", "docs/index.md", "docs/faq.md", "docs/quickstart.md")]
    advice = [re.findall(r"In one room start with .+?\. For unseen rooms start with .+?, and compare it with `[^`]+`\.",
                         page.read_text(encoding="utf-8")) for page in pages]
    assert all(len(found) == 1 for found in advice) and len({*map(tuple, advice)}) == 1


def test_every_agent_s_page_says_how_its_settings_are_changed_from_the_shell_too():
    pages = [page for page in (ROOT / "docs/agents").glob("*.md") if "## Settings" in page.read_text(encoding="utf-8")]
    assert len(pages) > 20
    assert [page.name for page in pages if "`--settings name=value`" not in page.read_text(encoding="utf-8")] == []


def test_the_table_of_extras_is_what_the_package_declares():
    page = (ROOT / "docs/installation.md").read_text(encoding="utf-8")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    table = page.partition("| extra |")[2].partition("\n\n")[0]
    rows = [row.split("|")[1:3] for row in table.splitlines()[2:]]
    assert {name for names, _ in rows for name in re.findall(r"`([\w-]+)`", names)} == extras.keys()
    (dev,) = [text for names, text in rows if "`dev`" in names]
    (held,) = re.findall(r"^hrl-escape\[(.+)\]$", "\n".join(extras["dev"]), re.M)
    assert {*re.findall(r"`([\w-]+)`", dev)} == extras.keys() - {"dev", *held.split(",")}
