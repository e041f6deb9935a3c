"""Seasons share rungs and have codes, rooms and graphs of their own; families of graphs have an exact Bayes planner."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from hrl_escape.benchmark.references.belief_graph import BeliefGraph
from hrl_escape.benchmark.references.graph_family import make_family
from hrl_escape.benchmark.references.path_lengths import PathLengths
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig, list_family
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.errors import ConfigError
from hrl_escape.sets import find_set, load_benchmark
from hrl_escape.sets.benchmark import compute_root

FAMILY = GraphConfig("layered", max_parents=2, family=3, code=5)


@pytest.mark.nightly
def test_a_season_has_its_own_code_and_rooms_which_its_sets_share():
    first, second = (load_benchmark(f"cues-1@{season}")["symbols"] for season in (0, 7))
    assert load_benchmark("cues-1")["symbols"].config == first.config
    assert (first.config.puzzle.cues.meanings != second.config.puzzle.cues.meanings).mean() > 0.5
    assert not set(first.test.seeds) & set(second.test.seeds) and len(first.test) == len(second.test) == 32
    assert first.train.config == first.valid.config == first.test.config
    rooms = find_set("cues-1@7/symbols/test#0..2")
    assert rooms.seeds == second.test.seeds[:2]
    for benchmark in ("cues-1", "families-1"):
        codes = {load_benchmark(f"{benchmark}@{season}")[rung].config.puzzle for season in range(20)
                 for rung in ("colours", "reset-6") if rung in [each.name for each in load_benchmark(benchmark)]}
        assert len(codes) == 20


def test_the_root_of_a_season_is_that_of_its_first_room():
    rung = load_benchmark("families-1@5")["reset-4"]
    assert rung.record.test.root == compute_root([rung.test[0].digest])


@pytest.mark.parametrize(("name", "words"), [("cues-1@20", "from cues-1@0 to cues-1@19"),
                                             ("ladder-1@0", "ladder-1, which has no seasons")])
def test_seasons_that_do_not_exist_are_refused(name: str, words: str):
    with pytest.raises(ConfigError, match=words):
        load_benchmark(name)


def test_rooms_of_a_family_use_all_its_graphs_and_controls_use_many():
    bench = load_benchmark("families-1@2")
    for name, graphs in (("ignore-6", 3), ("ignore-6-control", 25)):
        rung = bench[name]
        drawn = {(puzzle.edge_list, puzzle.goal) for seed in rung.train.seeds
                 for puzzle in (sample_puzzle(rung.config, seed)[1],)}
        assert len(drawn) == 3 if graphs == 3 else len(drawn) > graphs
    config = bench["ignore-6"].config.puzzle.graph
    assert {sample_puzzle(bench["ignore-6"].config, seed)[1].edge_list for seed in bench["ignore-6"].test.seeds} <= {
        edges for edges, _ in list_family(config, 6)}


def test_a_family_with_more_graphs_than_there_are_is_refused():
    with pytest.raises(ConfigError, match="family"):
        list_family(GraphConfig("chain", family=3), 2)


@pytest.mark.parametrize("rule", ["ignore", "reset"])
@pytest.mark.parametrize("count", [3, 4])
def test_the_bayes_planner_of_a_family_is_what_plain_recursion_finds(rule: str, count: int):
    """Random path lengths; the recursion knows the edges themselves, and nothing of belief graphs."""
    config = ButtonsConfig(count=count, on_violation=rule, graph=FAMILY)
    graphs = list_family(FAMILY, count)
    rng = np.random.default_rng(count)
    legs = rng.integers(1, 30, ((count + 1) * count, count)).astype(np.float32)
    arrivals = np.tile(np.arange(count) * count, count + 1)[:, None] + np.arange(count)
    leaving = rng.integers(1, 20, (count + 1) * count).astype(np.float32)

    @cache
    def cost(lit: frozenset[int], left: frozenset[int], place: int, pressed_in_vain: frozenset[int]) -> float:
        best = np.inf
        for button in set(range(count)) - lit - pressed_in_vain:
            after, total = int(arrivals[place, button]), float(legs[place, button])
            outcomes: dict[tuple, set[int]] = {}
            for number in left:
                edges, goal = graphs[number]
                if all(parent in lit for parent, child in edges if child == button):
                    key = ("open",) if button == goal else ("lit",)
                else:
                    key = ("reset",) if rule == "reset" and lit else ("dark",)
                outcomes.setdefault(key, set()).add(number)
            if outcomes.keys() == {("dark",)}:
                continue
            for (what,), numbers in outcomes.items():
                share, own = len(numbers) / len(left), frozenset(numbers)
                if what == "open":
                    total += share * float(leaving[after])
                elif what == "lit":
                    total += share * cost(lit | {button}, own, after, frozenset())
                elif what == "reset":
                    total += np.inf if own == left else share * cost(frozenset(), own, after, frozenset())
                else:
                    total += share * cost(lit, own, after, pressed_in_vain | {button})
            best = min(best, total)
        return best

    found = BeliefGraph(make_family(config, count))
    start = count * count  # the pose at the start is before any press
    solved = found.solve(PathLengths(legs, arrivals, leaving))
    for place in range(start, start + count):
        assert solved[found.root, place] == pytest.approx(
            cost(frozenset(), frozenset(range(3)), place, frozenset()), rel=1e-5)


def test_a_family_leaves_the_room_of_another_seed_as_it_was():
    plain = dataclasses.replace(FAMILY, family=0)
    assert "family" not in plain.to_dict() and FAMILY.to_dict()["family"] == 3
