"""Settings of a test run: threads, examples that are drawn, shards, the built site, and kernels compiled once."""

from __future__ import annotations

import atexit
import gc
import os
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.forks import RUN, run_fork

if TYPE_CHECKING:
    from hrl_escape.benchmark.comparison import Comparison

# One thread a process: xdist already fills the cores, and sums split over threads differ in the last bit.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault(RUN, str(os.getpid()))  # xdist's workers inherit it

# A busy machine is no failure, so no deadline; CI repeats the same examples, other runs look for new ones.
settings.register_profile("hrl-escape", deadline=None, derandomize="CI" in os.environ, max_examples=50)
settings.load_profile("hrl-escape")

KERNELS = (
    """
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import RoomPlanner
for name in ("clutter", "arm-two-button"):
    planner = RoomPlanner(generate(get_preset(name), 0))
    planner.solve(planner.rules.make_state(planner.instance.starts[0]))
""", """
from benchmarks.planner_contenders import make_queries
from hrl_escape.options.batched.env import BatchedOptionsEnv
make_queries("empty", range(1), 1)
BatchedOptionsEnv(1, "clutter")
""")
"""Scripts that compile most kernels; each compiles others, for twenty seconds of an idle core."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--site", help="folder of the built site, which tests/docs/test_site.py reads (`make docs`)")
    parser.addoption("--shard", default="1/1", help="part of the tests to run: 2/6 is the second of six")


@pytest.hookimpl(tryfirst=True)  # before a tier is chosen by its marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of one shard, and of the site if one is given; slow ones are nightly and have two hours."""
    mark_nightly_parameters(items)
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker("nightly")
            item.add_marker(pytest.mark.timeout(7200))
    number, count = map(int, config.getoption("shard").split("/"))
    assert 1 <= number <= count, "--shard takes a number and a count, as 2/6"
    kept = items[number - 1 :: count]
    if config.getoption("site"):  # the others are for `make test`
        kept = [item for item in kept if "site" in getattr(item, "fixturenames", ())]
    if len(kept) < len(items):
        config.hook.pytest_deselected(items=list({*items} - {*kept}))
        items[:] = kept


def mark_nightly_parameters(items: list[pytest.Item]) -> None:
    """Mark what `nightly_for` names; a name that no test has any more is an error where all are collected."""
    unknown: dict[tuple[str, str], None] = {}
    for item in items:
        name, _, parameters = item.name.partition("[")
        for marker in item.iter_markers("nightly_for"):
            unknown |= {(f"{item.path.name}::{name}", named): None for named in marker.args}
            if parameters[:-1] in marker.args:
                item.add_marker("nightly")
    for item in items:
        name, _, parameters = item.name.partition("[")
        unknown.pop((f"{item.path.name}::{name}", parameters[:-1]), None)
    if unknown and not any("::" in argument for argument in items[0].config.args):
        raise pytest.UsageError(f"nightly_for names parameters that no test has: {', '.join(map(str, unknown))}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs an accelerator where there is none."""
    if item.get_closest_marker("gpu"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("needs an accelerator")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Keep all that was loaded by now out of every later collection of garbage, which would walk through it.

    Pytest's own, when all tests are done, are among them; the interpreter takes all apart at its end.
    """
    atexit.register(gc.unfreeze)
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile kernels before xdist starts its workers, each of which would compile them itself."""
    if session.config.getoption("numprocesses", None) and not hasattr(session.config, "workerinput"):
        from hrl_escape.kernels import find_cache_folder

        done = {find_cache_folder() / f"compiled-{zlib.crc32(script.encode())}": script for script in KERNELS}
        missing = {file: script for file, script in done.items() if not file.exists()}
        with ThreadPoolExecutor() as pool:
            for file, compiled in zip(missing, pool.map(run_fork, missing.values()), strict=True):
                assert compiled.returncode == 0, compiled.stderr
                file.touch()


@pytest.fixture
def nothing_kept() -> Iterator[None]:
    """Every room is sampled in this test, and what it changes about that reaches no other."""
    from hrl_escape.env.sampling import generation

    generation._sample_room.cache_clear()
    yield
    generation._sample_room.cache_clear()


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """The small comparison, run once for all tests that only read it, in whichever worker they are."""
    from hrl_escape.benchmark.comparison import read_comparison
    from hrl_escape.processes import taking_turns
    from tests.benchmark.small import SMALL, OneProcess, run_quietly

    shared = tmp_path_factory.getbasetemp()
    folder = (shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared) / "small-comparison"
    with taking_turns(folder):
        if not (folder / "made").exists():
            run_quietly(SMALL, folder / "out", OneProcess())
            (folder / "made").touch()
        return read_comparison(folder / "out")
