"""Broken packages of other people: a warning to everybody, an error to who asks for them."""

from __future__ import annotations

import os
import sys

import pytest

from tests.forks import run_fork


@pytest.fixture
def run_with_broken(tmp_path):
    """Run a program where a package is installed whose puzzle, observation and agent cannot be loaded."""
    information = tmp_path / "broken-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(
        "[hrl_escape.puzzles]\nmaze = no_such_module:PUZZLE\n[hrl_escape.observations]\nsonar = no_such_module:SONAR\n"
        "[hrl_escape.agents]\noracle = no_such_module:Oracle\n")
    (tmp_path / "no_such_module.py").write_text("raise RuntimeError('of no version that goes with yours')\n")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    return lambda program: run_fork(program, environment=os.environ | {"PYTHONPATH": path})


def test_a_broken_package_stops_no_command_that_does_not_ask_for_it(run_with_broken, tmp_path):
    commands = [["room"], ["list", "puzzles", "observations", "agents"], ["train", "--help"],
                ["train", "random", "--primitives", "20", "--eval-episodes", "0", "--out", str(tmp_path / "run")]]
    done = run_with_broken("import contextlib\nfrom hrl_escape.cli import main\n"
                           f"for command in {commands!r}:\n"
                           "    with contextlib.suppress(SystemExit):  # of --help\n"
                           "        assert main(command) == 0, command\n"
                           "print('all ran')")
    assert done.returncode == 0 and done.stdout.endswith("all ran\n"), done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("ask", "what"), [
    ("from hrl_escape.env.puzzles.base import get_puzzle_kind as get; get('maze')", "puzzle 'maze'"),
    ("from hrl_escape.env.observations.base import get_observation as get; get('sonar')", "observation 'sonar'"),
    ("from hrl_escape.agents.registry import get_agent_class as get; get('smdp-oracle')", "agent 'oracle'"),
])
def test_who_asks_for_a_part_of_it_is_told_what_is_wrong(run_with_broken, ask, what):
    done = run_with_broken(ask)
    assert f"PluginError: the {what} of package 'broken' cannot be loaded" in done.stderr
    assert "of no version that goes with yours" in done.stderr


def test_others_are_warned_once_and_names_stay_known_by_their_closest(run_with_broken):
    done = run_with_broken("from hrl_escape.env.puzzles.base import get_puzzle_kind; get_puzzle_kind('button')")
    assert "UserWarning: left out: the puzzle 'maze' of package 'broken'" in done.stderr
    assert "did you mean 'buttons'?" in done.stderr
