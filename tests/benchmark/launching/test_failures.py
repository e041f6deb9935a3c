"""A run that raises and a run whose process dies are told, and stop no other run; on Ray too."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.clusters import RayLauncher
from hrl_escape.benchmark.launching.local import Failure, report_outcome
from hrl_escape.errors import MissingExtraError
from tests.benchmark.small import change, plant_strangers

needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs the extra ray")
ROOT = Path(__file__).parents[3]
SCRIPT = """
import json, os, sys
import torch
from rich.console import Console
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.clusters import RayLauncher
from tests.benchmark.small import change

if __name__ == "__main__":
    os.environ["PYTHONPATH"] = os.pathsep.join([os.path.abspath("of_workers"), os.environ["PYTHONPATH"]])
    grid = change(runs=1, agents=sys.argv[1:], primitives=200)
    comparison = run_grid(grid, "out", RayLauncher(1, resources={"max_retries": 0}), Console(file=sys.stderr))
    failures = {failed.run.agent.label: [failed.message, failed.traceback] for failed in comparison.failures}
    print(json.dumps([[run.agent.label for run, _ in comparison.runs], failures]))
"""


def run_on_ray(folder: Path, *agents: str) -> tuple[list[str], dict[str, list[str]]]:
    """Agents that finished, and messages and tracebacks of those that failed, as a user's script sees them."""
    plant_strangers(folder)
    (folder / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "script.py", *agents], cwd=folder, capture_output=True, text=True,
                          env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])})
    assert done.returncode == 0, done.stderr
    return tuple(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.slow
@needs_ray
def test_a_task_that_raises_and_one_that_crashes_are_told_and_stop_no_others(tmp_path: Path):
    finished, failures = run_on_ray(tmp_path, "raiser", "crasher", "random")
    assert finished == ["random"]
    message, trace = failures["raiser"]
    assert message == "KeyError: 'what a stranger forgot'" and "in fall" in trace
    message, trace = failures["crasher"]
    assert message.startswith("Ray lost its process, and retries of it: The worker died unexpectedly") and trace


@pytest.mark.slow
@needs_ray
def test_a_machine_that_cannot_import_what_a_task_needs_is_told(tmp_path: Path):
    (tmp_path / "of_workers").mkdir()
    (tmp_path / "of_workers" / "torch.py").write_text("raise ImportError('no torch on this machine')")
    finished, failures = run_on_ray(tmp_path, "random")
    assert finished == []
    assert failures["random"][0] == "its task could not begin: ImportError: no torch on this machine"


class Listener:
    """Keeps the failures that it is told of."""

    def __init__(self) -> None:
        self.failures: list[Failure] = []

    def finish(self, run: Any, result: Any) -> None:
        raise AssertionError("no run has finished here")

    def fail(self, failure: Failure) -> None:
        self.failures.append(failure)

    def tick(self, progress: Any) -> None:
        raise AssertionError("nothing runs here")


def test_a_process_that_is_lost_without_a_word_is_told(tmp_path: Path):
    (run,), listener = change(runs=1, agents=["random"]).make_runs(change(runs=1).make_places()), Listener()
    report_outcome(tmp_path, run, None, None, listener)
    report_outcome(tmp_path, run, -9, None, listener)
    report_outcome(tmp_path, run, 3, None, listener)
    assert [failure.message for failure in listener.failures] == [
        "its process died and left no result",
        "its process was ended by SIGKILL; the machine may have run out of memory",
        "its process ended with code 3 and left no result"]


def test_without_ray_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with open(os.devnull, "w") as nowhere, pytest.raises(MissingExtraError, match=r"\.\[ray\]"):
        run_grid(change(runs=1), tmp_path, RayLauncher(1), Console(file=nowhere))
