"""Every rung of every benchmark trains, and is tested, under every protocol; in two rooms and a few primitives."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.protocols import (
    TOWER,
    LadderSettings,
    Protocol,
    choose_floors,
    make_protocol_grid,
    make_tower_grid,
)
from hrl_escape.benchmark.runs import execute_run, load_run_result
from hrl_escape.errors import GridError
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark

RUNGS = [(name, rung.name) for name in list_benchmarks() for rung in load_benchmark(name)]
LEARNERS = {"per-instance": "smdp-q-learning"}
GENERALISER = "smdp-dqn+objects+memory"


def choose_settings(**fields: Any) -> LadderSettings:
    return LadderSettings(runs=1, primitives=10, rooms=2, train_sizes=(2,), eval_episodes=2, trials=2, **fields)


def run_all(grid: Grid, out) -> None:
    """Make the grid's runs in this process."""
    places = grid.make_places()
    for place in places:
        place.save(out / "rooms")
    runs = grid.make_runs(places)
    for run in runs:
        execute_run(run, out, checkpoint_seconds=60)
        result = load_run_result(out, run)
        assert result is not None and result.primitives >= 10 and len(result.evaluations) >= 2
        assert (result.seen is None) == (not grid.train_rooms)
        assert len(result.trials) == (grid.trials if grid.trials > 1 else 0)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", [name for name in get_args(Protocol) if name != TOWER])
@pytest.mark.parametrize(("source", "rung"), RUNGS)
def test_a_rung_trains_under_a_protocol(source, rung, protocol, tmp_path):
    bench = load_benchmark(source)
    floors = [name for name in choose_floors(bench) if name != rung]
    settings = choose_settings(source=floors[0] if protocol == "transfer" else None)
    agent = AgentSpec.parse(LEARNERS.get(protocol, GENERALISER))
    grid = make_protocol_grid(bench, rung, protocol, [agent], settings)
    if protocol == "transfer" and rung not in choose_floors(bench):
        with pytest.raises(GridError, match="take sets of rooms with the same robot"):
            grid.make_places()
        return
    run_all(grid, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("source", list_benchmarks())
def test_the_tower_of_a_benchmark_is_trained_in(source, tmp_path):
    bench = load_benchmark(source)
    run_all(make_tower_grid(bench, choose_floors(bench), [AgentSpec.parse(GENERALISER)], choose_settings()), tmp_path)
