"""Plans do not depend on the wall clock, unless a limit is asked for; compilation is never in it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hrl_escape
from hrl_escape import kernels
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.paths.navigator import Navigator
from hrl_escape.planning.planner import RoomPlanner
from tests.command_line import run_here

SCRIPT = """
import hashlib
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import RoomPlanner
plans = []
for name, method in (("clutter", "fields"), ("clutter", "RRTConnect"), ("arm-two-button", "fields")):
    planner = RoomPlanner(generate(get_preset(name), 4), method)
    plans.append(planner.solve(planner.rules.make_state(planner.instance.starts[0])).primitives)
print(hashlib.sha256(repr(plans).encode()).hexdigest())
"""


def make_planner(name="clutter", seed=0, **settings):
    planner = RoomPlanner(generate(get_preset(name), seed), **settings)
    return planner, planner.rules.make_state(planner.instance.starts[0])


@pytest.mark.slow
def test_a_machine_busy_with_other_work_makes_the_same_plans():
    """Burns a core a processor while it plans; the fast proof is the clock that leaps, below."""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        starved = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True).stdout
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert len(starved.strip()) == 64 and starved == run_here(SCRIPT)


@pytest.mark.parametrize("method", ["fields", "RRTConnect"])
def test_a_machine_on_which_every_look_at_the_clock_takes_a_minute_makes_the_same_plans(monkeypatch, method):
    planner, start = make_planner(method=method)
    expected = planner.solve(start).primitives
    now = [0.0]

    def leap():
        now[0] += 61.0
        return now[0]

    monkeypatch.setattr(time, "perf_counter", leap)
    slow, _ = make_planner(method=method)
    assert slow.solve(start).primitives == expected


def test_a_limit_holds_over_the_whole_call_and_its_result_says_so():
    """Nothing in this room leads within 0.5 m of the place, so that every finer grid would be searched."""
    planner, start = make_planner(time_limit=0.5)
    planner.plan(start, "button-1")
    for attempt in (lambda: planner.plan(start, "10.0,0.0"), lambda: planner.plan(start, "0.03,0.04,1")):
        began = kernels.read_clock()
        try:
            timed_out = attempt().timed_out
        except PlanningFailed as failure:
            timed_out = failure.reason is PlanningReason.TIMEOUT
        took = kernels.read_clock() - began
        assert took < 1.5 and timed_out == (took > 0.5)
    with pytest.raises(PlanningFailed, match="timeout"):
        make_planner("twenty-button", time_limit=0.02)[0].solve(start)


def test_a_plan_made_without_a_limit_was_not_cut_short():
    planner, start = make_planner()
    assert not planner.solve(start).timed_out and planner.routes.time_limit is None


@pytest.mark.parametrize("limit", [-1.0, float("nan"), "1", True])
def test_a_limit_that_is_none_is_refused(limit):
    with pytest.raises(ConfigError, match="time_limit"):
        make_planner(time_limit=limit)


def test_a_path_says_whether_time_or_budget_ended_its_search():
    navigator = Navigator(generate(get_preset("clutter"), 1))
    start = navigator.instance.starts[0]
    hidden = PressGoal(3)
    assert navigator.plan((start.x, start.y), hidden, time_limit=0.0).status == "timeout"
    assert navigator.plan((start.x, start.y), hidden, budget=40).status == "budget-exhausted"


# --- compilation: tests/test_planting.py sees it, in a copy of the package with an empty cache ---------


def test_what_another_version_compiled_is_never_loaded(monkeypatch, tmp_path):
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path))
    one = kernels.find_cache_folder()
    monkeypatch.setattr(kernels, "__version__", "0.0.1")
    other = kernels.find_cache_folder()
    monkeypatch.setattr(kernels, "SOURCES", kernels.SOURCES[1:])
    assert len({one, other, kernels.find_cache_folder()}) == 3
    assert all(folder.is_relative_to(tmp_path) and folder.is_dir() for folder in (one, other))


def test_every_module_with_kernels_is_a_source_of_the_caches_key():
    package = Path(hrl_escape.__file__).parent
    pattern = re.compile(r"^(import numba$|from numba import|from hrl_escape\.kernels import kernel)", re.MULTILINE)
    users = {str(path.relative_to(package)) for path in package.rglob("*.py") if pattern.search(path.read_text())}
    assert users - {"kernels.py"} <= set(kernels.SOURCES)
    found = {name for source in kernels.SOURCES
             for name in re.findall(r"^from hrl_escape\.([\w.]+) import", (package / source).read_text(), re.MULTILINE)}
    files = {file for name in found for stem in (package / name.replace(".", "/"),)
             for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()}
    beside = {"env/bases/link.py", "env/schema.py", "errors.py", "kernels.py", "settings.py"}  # no kernel's constants
    assert {str(file.relative_to(package)) for file in files} - beside <= set(kernels.SOURCES)
    assert len(files) > 10 and all((package / name).is_file() for name in kernels.SOURCES)


def test_kernels_lie_by_their_place_in_the_package_and_those_of_others_by_their_path(tmp_path):
    """tests/test_planting.py sees a checkout load what another has compiled."""
    place = kernels.SourceLocator.get_suitable_cache_subpath
    assert place(str(Path(hrl_escape.__file__).parent / "floor/sweeps.py")) == "hrl_escape-floor"
    assert len({place(str(tmp_path / name / "base.py")) for name in "ab"}) == 2
