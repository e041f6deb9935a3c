"""Cost before a run: the published rates are those of the studies' lines, and hours are counted as by hand."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from benchmarks.ladder import collect_rates, read_lines
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark import cost
from hrl_escape.benchmark.cost import count_buttons, describe_cost, estimate_hours, estimate_rate, load_rates
from hrl_escape.benchmark.grid import Grid
from hrl_escape.cli import main
from hrl_escape.sets.benchmark import load_benchmark

RATES = {"smdp-dqn": {2: 1.0, 4: 3.0}, "dqn": {3: 0.5}}


def test_the_table_of_rates_is_what_the_studies_tell():
    kept = json.loads(Path(cost.__file__).with_name("costs.json").read_text())
    assert kept == json.loads(json.dumps(collect_rates(read_lines()))) and len(load_rates()) >= 8
    lines = [{"agent": "smdp-dqn", "buttons": 2, "primitives": 1000, "seconds": 3.0},
             {"agent": "smdp-dqn", "buttons": 2, "primitives": 3000, "seconds": 5.0},
             {"agent": "smdp-dqn", "buttons": 4, "primitives": 1000, "seconds": 9.0},
             {"agent": "dqn, hindsight", "buttons": 2, "primitives": 1000, "seconds": 9.0}]
    assert collect_rates(lines) == {"smdp-dqn": {2: 2.0}}


def test_rates_are_interpolated_between_and_kept_beyond_what_is_known():
    assert [estimate_rate("smdp-dqn", buttons, RATES) for buttons in (1, 2, 3, 4, 20)] == [1.0, 1.0, 2.0, 3.0, 3.0]
    assert estimate_rate("dac", 2, RATES) is None


def test_hours_are_runs_times_primitives_times_rate():
    agents = [AgentSpec.parse(text) for text in ("smdp-dqn", "dqn", "random-options", "oracle", "dac")]
    hours, unknown = estimate_hours(agents, 18_000, [2, 3], 10, RATES)
    assert hours == pytest.approx(10 * 18 * (1.0 + 2.0 + 0.5 + 0.5) / 3600) and unknown == ["dac"]


def test_buttons_of_a_room_configuration_are_counted_for_every_puzzle():
    bench = load_benchmark("ladder-1")
    assert count_buttons(bench["pair"].config) == 2 and 6 <= count_buttons(bench["lattice"].config) <= 10
    assert all(count_buttons(rung.config) >= 1 for rung in bench)


def test_words_on_a_grid_and_the_list_of_rungs_tell_the_cost(capsys):
    grid = Grid(agents=(AgentSpec("smdp-q-learning"), AgentSpec("dac")), runs=2, primitives=50)
    told = describe_cost(grid, grid.make_places())
    assert re.fullmatch(r"about 0\.\d s of training on one core by published rates, and that of dac, of which no rate "
                        "is published", told)
    searches = dataclasses.replace(grid, agents=(AgentSpec("search-memory"), AgentSpec("count-cues")))
    assert "and that of search-memory, of which" in describe_cost(searches, grid.make_places())
    in_sets = dataclasses.replace(searches, rooms=(), train_rooms=("ladder-1/pair/train#0..1",),
                                  test_rooms=("ladder-1/pair/test#0..1",))
    assert "and that of count-cues, of which" in describe_cost(in_sets, in_sets.make_places())
    hours = describe_cost(dataclasses.replace(grid, runs=200, primitives=200_000), grid.make_places())
    assert re.match(r"about \d+ h \d+ min of training", hours), hours
    assert main(["ladder", "list", "--json"]) == 0
    rows = {row["rung"]: row for row in json.loads(capsys.readouterr().out)["rungs"]}
    by_hand = 10 * 10 * 20 * estimate_rate("smdp-dqn", 2, load_rates()) / 3600
    assert rows["pair"]["core_hours"] == pytest.approx(by_hand, abs=0.01) and rows["house"]["core_hours"] > 10
