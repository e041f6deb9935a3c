"""Plans do not depend on the wall clock, unless a limit is asked for; compilation is never in it."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import time
import tokenize
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
from tests.forks import run_file, run_fork

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


@pytest.mark.nightly_for("fields")
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
    planner.plan(start, "press-button-1")
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


@pytest.mark.nightly
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


# --- compilation -----------------------------------------------------------------------------------

KERNEL = """
import numpy, sys, time
from hrl_escape.kernels import kernel, read_clock

@kernel
def add_up(numbers):
    total = 0.0
    for number in numbers:
        total += number * number
    return total

began, counted = time.perf_counter(), read_clock()
assert add_up(numpy.ones(3)) == 3.0
print(time.perf_counter() - began, read_clock() - counted, "numba.np.arraymath" in sys.modules)
"""


def test_compilation_is_announced_once_and_counts_into_no_time(tmp_path):
    (tmp_path / "own.py").write_text(KERNEL)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first = run_file(tmp_path / "own.py", environment=environment, check=True)
    second = subprocess.run([sys.executable, tmp_path / "own.py"], env=environment, check=True, capture_output=True,
                            text=True)  # a fork has loaded all of numba
    assert first.stderr.count("compiling kernels for your own code, once for this version") == 1
    assert "compiling" not in second.stderr
    whole, counted = map(float, first.stdout.split()[:2])
    assert counted < whole / 2
    assert second.stdout.split()[2] == "False", "numba loaded what only compiling needs"


COMPILED = """
import time
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import RoomPlanner
planner = RoomPlanner(generate(get_preset("paper-two-button"), 0), time_limit=10.0)
began = time.perf_counter()
plan = planner.solve(planner.rules.make_state(planner.instance.starts[0]))
print(plan.seconds, time.perf_counter() - began, plan.timed_out)
"""
"""Plans under a limit that compiling alone would exceed on a slow machine."""


@pytest.mark.slow
def test_a_copy_of_the_package_with_other_docstrings_loads_what_the_checkout_has_compiled(tmp_path):
    copy, here = tmp_path / "copy", Path(hrl_escape.__file__).parent
    shutil.copytree(here, copy / "hrl_escape", ignore=shutil.ignore_patterns("__pycache__"))
    edited = copy / "hrl_escape" / "planning/search/a_star.py"
    code = edited.read_text().split('"""', 2)[2]
    edited.write_text('"""Another docstring.\n' + "It moves all kernels down.\n" * 40 + f'"""{code}')
    first, second = (run_fork(COMPILED, check=True, environment=os.environ | {
        "PYTHONPATH": str(place), "NUMBA_CACHE_DIR": str(tmp_path)}) for place in (here.parent, copy))
    uses = re.findall(r"compiling kernels for ([^,\n]+), once for this version", first.stderr)
    assert "the planner's search" in uses and len(set(uses)) == len(uses) == first.stderr.count("compiling kernels")
    assert "compiling" not in second.stderr
    seconds, whole, timed_out = first.stdout.split()
    assert float(seconds) < float(whole) / 2 and timed_out == "False"


def test_what_another_version_compiled_is_never_loaded(monkeypatch, tmp_path):
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path))
    one = kernels.find_cache_folder()
    monkeypatch.setattr(kernels, "__version__", "0.0.1")
    other = kernels.find_cache_folder()
    monkeypatch.setattr(kernels, "SOURCES", kernels.SOURCES[1:])
    assert len({one, other, kernels.find_cache_folder()}) == 3
    assert all(folder.is_relative_to(tmp_path) and folder.is_dir() for folder in (one, other))


def test_a_new_cache_begins_with_the_kernels_of_the_installation_but_one_of_its_own_begins_empty(monkeypatch, tmp_path):
    (tmp_path / "installed" / "kernels").mkdir(parents=True)
    (tmp_path / "installed" / "kernels" / "search.nbc").write_bytes(b"code")
    monkeypatch.setattr(kernels, "INSTALLED", tmp_path / "installed")
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    folder = kernels.make_cache_folder("kernels")
    assert (folder / "search.nbc").read_bytes() == b"code" and folder.is_relative_to(tmp_path / "new")
    assert list(folder.parent.iterdir()) == [folder], "what was copied on the way is left"
    (folder / "search.nbc").write_bytes(b"newer")
    assert (kernels.make_cache_folder("kernels") / "search.nbc").read_bytes() == b"newer"
    assert list(kernels.make_cache_folder("others").iterdir()) == []
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path / "own"))
    assert list(kernels.make_cache_folder("kernels").iterdir()) == []


@pytest.mark.parametrize(("old", "new", "is_same"), [
    (b"def f(x):\n    return x\n", b'"""A."""\n\n\ndef f(x):  # of x\n    """Return it."""\n\n    return x\n', True),
    (b'a = 1\n"""One."""\n', b'a = 1\n"""One\n\n# or less."""\n', True),
    (b"def f(x):\n    return x\n", b"def f(x):\nreturn x\n", False),
    (b"a = 1\n", b"a = 2\n", False),
    (b'a = "#1"  # one\n', b'a = "#2"  # one\n', False),
    (b"a = 'it\\'s #1'\n", b"a = 'it\\'s #2'\n", False),
])
def test_prose_of_a_source_is_no_part_of_the_caches_key(old, new, is_same):
    assert (kernels.strip_prose(old) == kernels.strip_prose(new)) == is_same


@pytest.mark.parametrize("name", kernels.SOURCES)
def test_all_code_of_a_source_is_part_of_the_caches_key(name):
    """By the tokens of Python: all but comments, line ends and expressions that are only a text."""
    source = (Path(kernels.__file__).parent / name).read_bytes()
    skipped = tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING

    def read(text: bytes) -> list[str]:
        found, begins = [], True
        for token in tokenize.tokenize(io.BytesIO(text).readline):
            if token.type not in skipped and not (begins and token.type == tokenize.STRING):
                found.append(token.string)
            begins = token.type in skipped and (begins or token.type not in (tokenize.COMMENT, tokenize.NL))
        return found

    assert read(kernels.strip_prose(source)) == read(source) and len(kernels.strip_prose(source)) < len(source)


def test_every_module_with_kernels_is_a_source_of_the_caches_key():
    """So is what these import: functions, constants, and the tuples that kernels are given."""
    package = Path(hrl_escape.__file__).parent
    pattern = re.compile(r"^(import numba$|from numba import|from hrl_escape\.kernels import kernel)", re.MULTILINE)
    users = {str(path.relative_to(package)) for path in package.rglob("*.py") if pattern.search(path.read_text())}
    assert users - {"kernels.py"} <= set(kernels.SOURCES)
    compiled = users - {"kernels.py"} | {"env/geometry.py", "env/bases/disc.py", "env/bases/rectangle.py"}
    found = {name for source in compiled
             for name in re.findall(r"^from hrl_escape\.([\w.]+) import", (package / source).read_text(), re.MULTILINE)}
    files = {file for name in found for stem in (package / name.replace(".", "/"),)
             for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()}
    beside = {"env/__init__.py", "env/schema.py", "errors.py", "kernels.py", "settings.py"}
    beneath = {str(file.relative_to(package)) for file in files} - beside
    assert beneath == {"agents/factored/structure.py", "env/bases/base.py", "env/geometry.py", "floor/sweeps.py"}
    assert beneath <= set(kernels.SOURCES) and all((package / name).is_file() for name in kernels.SOURCES)


def test_a_part_of_kernels_is_called_by_them_alone():
    part = kernels.kernel_part(lambda x: x + 1)
    with pytest.raises(TypeError):
        part(1)
    assert kernels.numba.njit(lambda x: 2 * part(x))(1) == 4
    with pytest.raises(TypeError):
        part(1)


def test_kernels_lie_by_their_place_in_the_package_and_those_of_others_by_their_path(tmp_path):
    place = kernels.SourceLocator.get_suitable_cache_subpath
    assert place(str(Path(hrl_escape.__file__).parent / "floor/sweeps.py")) == "hrl_escape-floor"
    assert len({place(str(tmp_path / name / "base.py")) for name in "ab"}) == 2
