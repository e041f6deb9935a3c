"""The registry of named parts, and parts of other packages that cannot be loaded."""

from __future__ import annotations

import os
import sys
from importlib.metadata import EntryPoint

import pytest

from hrl_escape.errors import ConfigError, PluginError, UnknownNameError
from hrl_escape.registry import Registry
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


@pytest.mark.nightly
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


def test_a_list_warns_of_what_it_leaves_out_and_a_wrong_name_imports_nothing(run_with_broken):
    done = run_with_broken("from hrl_escape.env.puzzles.base import list_puzzles; print('maze' in list_puzzles())")
    assert "UserWarning: left out: the puzzle 'maze' of package 'broken'" in done.stderr
    assert done.stdout == "False\n"
    done = run_with_broken("from hrl_escape.env.puzzles.base import get_puzzle_kind; get_puzzle_kind('button')")
    assert "did you mean 'buttons'?" in done.stderr and "left out" not in done.stderr


# --- the registry by itself -----------------------------------------------------------------


def make_registry(**shipped):
    return Registry("part", "a tuple", lambda part: isinstance(part, tuple), shipped)


def test_a_registered_part_is_found_and_its_name_is_taken():
    parts = make_registry()
    parts.register("one", (1,))
    parts.register("one", (1,))  # the same again
    assert parts.get("one") == (1,) and "one" in parts and list(parts) == ["one"]
    with pytest.raises(ConfigError, match="no other part has"):
        parts.register("one", (2,))
    with pytest.raises(ConfigError, match="a tuple"):
        parts.register("two", 2)
    parts.unregister("one")
    assert "one" not in parts and not parts.names()


def test_shipped_parts_are_imported_when_they_are_asked_for():
    parts = make_registry(version="sys:version_info", made=lambda: (3,), missing="sys:no_such_name")
    assert parts.names() == ("version", "made", "missing")
    assert parts.get("version") is sys.version_info and parts.get("made") == (3,)
    with pytest.raises(ConfigError, match="no other part has"):
        parts.register("made", (4,))


def test_an_unknown_name_is_answered_with_the_closest():
    with pytest.raises(UnknownNameError, match="did you mean 'version'"):
        make_registry(version="sys:version_info").get("versoin")
    with pytest.raises(UnknownNameError, match="part"):
        make_registry().get(None)


def test_entry_points_are_named_at_once_and_loaded_when_asked_for(monkeypatch):
    group = "hrl_escape.parts"
    points = [EntryPoint("theirs", "sys:version_info", group), EntryPoint("odd", "sys:path", group)]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: {"hrl_escape.parts": points}[group])
    parts = make_registry()
    parts.register("own", ())
    assert parts.names() == ("own", "odd", "theirs") and parts.get("theirs") is sys.version_info
    with pytest.raises(PluginError, match="'odd'.*'sys:path'.*must be a tuple"):
        parts.get("odd")
    with pytest.warns(UserWarning, match="left out: the part 'odd'"):
        assert list(parts.load_all()) == ["own", "theirs"]
