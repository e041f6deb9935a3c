"""Parts of another package: files of `examples`, installed with entry points, arrive at every command by name."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.forks import run_file, run_fork, run_module

ROOT = Path(__file__).parents[2]
PARTS = {
    "agents": {"monte-carlo": ("own_agent.py", "MonteCarlo"), "mellow-dqn": ("extend/mellow_dqn.py", "MellowDQN")},
    "observations": {"compass": ("extend/compass.py", "Compass")},
    "puzzles": {"toggles": ("extend/toggles.py", "KIND")},
    "rewards": {"steady": ("own_reward.py", "SteadyReward")},
    "option_sets": {"press-or-go-home": ("own_option_set.py", "make_press_or_go_home")},
    "path_planners": {"grid": ("extend/grid_planner.py", "make_grid_planner")},
}
"""Entry-point group -> name -> file of `examples` and what it publishes."""


def install(folder: Path, parts: dict[str, dict[str, tuple[str, str]]]) -> dict[str, str]:
    """Lay out a package as an installer would, and return the environment that finds it."""
    information = folder / "stranger-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    lines = []
    for group, members in parts.items():
        lines.append(f"[hrl_escape.{group}]")
        for name, (file, attribute) in members.items():
            shutil.copy(ROOT / "examples" / file, folder)
            lines.append(f"{name} = {Path(file).stem}:{attribute}")
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}


ACTS = """
import contextlib, io, json
import numpy
from hrl_escape.checks import check_agent, check_path_planner, check_puzzle
from hrl_escape.cli import main
from hrl_escape.agents.registry import get_agent_class
from hrl_escape.env.puzzles.base import get_puzzle_kind

said = {}


def call(name, *arguments):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(list(arguments)) == 0, arguments
    said[name] = out.getvalue()


call("list", "list", "agents", "puzzles", "observations", "option-sets", "--json")
budget = ["--room", "paper-one-button", "--primitives", "60", "--eval-episodes", "1", "--json"]
call("option agent", "train", "smdp-monte-carlo", *budget, "--option-set", "press-or-go-home",
     "--set", "reward.kind=steady", "reward.turn_cost=0.25", "--out", "option-agent")
call("flat agent", "train", "mellow-dqn", *budget, "--observation", "compass", "--settings", "omega=3", "warmup=20",
     "--out", "flat-agent")
call("puzzle", "solve", "--set", "puzzle.kind=toggles", "--room", "custom#1", "--planner", "grid", "--json")
check_agent(get_agent_class("monte-carlo"))
check_puzzle(get_puzzle_kind("toggles").config_type().make_puzzle(numpy.random.default_rng(0)))
check_path_planner("grid", queries=2)
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What the commands print where the package is installed, and the folder of their runs."""
    folder, work = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("work")
    done = run_fork(ACTS, cwd=work, environment=install(folder / "stranger", PARTS))
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout), work


def read_run(work: Path, name: str) -> str:
    return (work / name / "run.json").read_text()


def test_names_of_all_parts_are_listed(stranger):
    said, _ = stranger
    listed = json.loads(said["list"])
    for kind in ("agents", "puzzles", "observations"):
        assert PARTS[kind].keys() <= set(listed[kind]), kind
    assert "press-or-go-home" in listed["option-sets"]


def test_an_algorithm_trains_over_an_option_set_for_a_reward(stranger):
    said, work = stranger
    assert json.loads(said["option agent"])["primitives"] >= 60
    run = read_run(work, "option-agent")
    assert "press-or-go-home" in run and '"steady"' in run and "0.25" in run


def test_a_variant_trains_on_an_observation_with_a_setting_of_its_own(stranger):
    said, work = stranger
    assert json.loads(said["flat agent"])["primitives"] >= 60
    run = json.loads(read_run(work, "flat-agent"))
    assert '"compass"' in json.dumps(run) and '"omega": 3' in json.dumps(run)


def test_a_puzzle_is_solved_along_paths_of_a_path_planner(stranger):
    said, _ = stranger
    assert "press-a" in said["puzzle"] and "grid" in said["puzzle"]


def test_a_base_is_known_by_its_entry_point(tmp_path: Path):
    """Tests of the base itself, in both engines and for planners, are in `tests/env/bases`."""
    environment = install(tmp_path / "stranger", {"bases": {"diamond": ("extend/diamond.py", "Diamond")}})
    done = run_fork("from hrl_escape.env.config import RobotConfig\n"
                    "print(RobotConfig(footprint='diamond', body_radius=0.5).base.describe())", environment=environment)
    assert done.stdout == "a diamond of 1 m\n", done.stderr


@pytest.mark.nightly
def test_a_rung_is_frozen_shown_and_played_from_its_file(tmp_path: Path):
    shutil.copy(ROOT / "examples/extend/own-ladder.json", tmp_path)
    frozen = run_module("benchmarks.ladder", "freeze", "own-ladder.json", cwd=tmp_path,
                        environment=os.environ | {"PYTHONPATH": str(ROOT)})
    assert frozen.returncode == 0, frozen.stderr
    done = run_fork("from hrl_escape.cli import main\n"
                    "import gymnasium, hrl_escape\n"
                    "assert main(['ladder', 'show', 'two', '--benchmark', 'own-ladder.json']) == 0\n"
                    "assert main(['ladder', 'verify', '--benchmark', 'own-ladder.json']) == 0\n"
                    "where = {'benchmark': 'own-ladder.json', 'rung': 'two', 'set': 'test'}\n"
                    "env = gymnasium.make('hrl_escape/Ladder-v1', **where)\n"
                    "print(len(env.reset(seed=0)[1]))", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "chain" in done.stdout and "8" in done.stdout


def test_a_script_has_options_of_its_own_next_to_those_that_choose_a_room():
    done = run_file(ROOT / "examples/extend/measure_room.py", "--room", "clutter#3", "--density")
    assert re.fullmatch(r"\d+ m2, \d+\.\d obstacles per 100 m2\n", done.stdout), done.stderr


def test_the_page_states_the_lines_of_every_example():
    page = (ROOT / "docs/extend/index.md").read_text()
    rows = re.findall(r"^\| \[.+?\]\(.+?\) \| `(examples/.+?)` \| 1 \| (\d+) \|", page, re.MULTILINE)
    assert {file: int(lines) for file, lines in rows} == {
        file: len((ROOT / file).read_text().splitlines()) for file, _ in rows}
    named = {f"examples/{file}" for members in PARTS.values() for file, _ in members.values()}
    assert named <= {file for file, _ in rows} and len(rows) >= 11
