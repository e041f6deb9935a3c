"""Generalisation: the grids of the study, and its page from lines written by hand."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hrl_escape.sets.benchmark import load_benchmark
from studies.baseline import BaselineRun
from studies.generalisation.grids import (
    AT_ONCE,
    CEILING,
    DEPTHS,
    FLAT,
    FLAT_CHANCE,
    MEMORY,
    OBJECTS,
    SEARCH_BASELINES,
    TRAINED,
    TRANSFER,
    VECTORS,
    GeneralisationArgs,
    make_depth_grid,
    make_sizes_grid,
)
from studies.generalisation.many import run_course, run_many, run_reference
from studies.generalisation.transfer import read_transfers, tell_transfers
from studies.ladder.calibration import CHANCE
from tests.studies.pages import tell

ARGS = GeneralisationArgs(rung="pair", runs=2, primitives=500, rooms=3, shallow_rooms=6, first_seed=7)
LINE = BaselineRun("sizes", "pair", "x/train#0..1 > x/test", VECTORS, 0, 500, 0.2, 1.0, 0.5, 3, 0.5, 70, "abc")


def test_rooms_trained_in_grow_and_those_tested_in_stay():
    grid = make_sizes_grid(load_benchmark("ladder-1"), ARGS)
    places = grid.make_places()
    assert [len(place.split.train) for place in places] == [1, 4, 16, 64, 256, 1000]
    assert len({tuple(place.split.test.seeds) for place in places}) == 1 and len(places[0].split.test) == 3
    assert len(grid.make_runs(places)) == 2 * 6 * 9 and grid.first_seed == 7
    few = make_sizes_grid(load_benchmark("ladder-1"), dataclasses.replace(ARGS, sizes=(1, 16), agents=(VECTORS,)))
    assert [agent.label for agent in few.agents] == [VECTORS] and len(few.train_rooms) == 2


def test_rooms_tested_in_are_deeper_than_any_trained_in(tmp_path: Path):
    grid = make_depth_grid(load_benchmark("ladder-1"), ARGS, tmp_path)
    places = grid.make_places()
    assert [place.split.test.name for place in places] == list(DEPTHS)
    trained = {len(room.targets) for room in places[0].split.train}
    assert trained <= {2, 3, 4} and len(trained) > 1
    for place, depth in zip(places, DEPTHS.values(), strict=True):
        for room in place.split.test:
            edges = room.puzzle.edges
            assert len(room.targets) == depth["count"]
            assert (len(edges) == len({head for _, head in edges}) == depth["count"] - 1) or depth["graph"] == "layered"
    assert len(grid.make_runs(places)) == 2 * 4 * 7, "and agents can act in both"


def test_the_page_tells_sizes_and_depths_by_the_lines_alone(tmp_path: Path):
    lines = [LINE, dataclasses.replace(LINE, rooms="x/train#0..16 > x/test", efficiency=0.6),
             dataclasses.replace(LINE, agent=MEMORY, efficiency=0.9)]
    page = tell("generalisation", lines, tmp_path)
    assert f"| `{VECTORS}` | 0.20 (1.00) | 0.60 (1.00) |" in page and f"| `{MEMORY}` | 0.90 (1.00) | - |" in page
    assert "options, a vector 0.20 with 1 and 0.60 with 16" in page and "Not run yet." in page
    assert "Nothing is concluded from fewer than 10 seeds." in page
    assert (tmp_path / "figures" / "generalisation.svg").stat().st_size > 1000
    depth = dataclasses.replace(LINE, protocol="depth", rung="8 buttons, layered", rooms="a > b", efficiency=0.3)
    many = [dataclasses.replace(LINE, seed=seed) for seed in range(10)]
    assert "Nothing is concluded" not in tell("generalisation", many)
    page = tell("generalisation", [*lines, depth])
    assert f"| `{VECTORS}` | - | - | 0.30 | - | 1.00 |" in page and "Not run yet." not in page


def test_rungs_have_tables_and_commands_of_their_own_and_seeds_are_counted_by_cell():
    other = dataclasses.replace(LINE, rung="chain-3", efficiency=0.7)
    chance = dataclasses.replace(LINE, agent=CHANCE, primitives=0)
    lines = [LINE, *(dataclasses.replace(other, seed=seed) for seed in range(3)), chance,
             dataclasses.replace(other, agent=MEMORY, rooms="x/train#0..4 > x/test")]
    page = tell("generalisation", lines)
    assert f"| `{VECTORS}` | 0.20 (1.00) |\n" in page and f"| `{VECTORS}` | 0.70 (1.00) | - |\n" in page
    assert page.count("trained in. That is less than the budget of the study itself, 1,000,000.") == 2
    assert "That is less" not in tell("generalisation", [dataclasses.replace(LINE, primitives=1_000_000)])
    assert "2 runs: 1 training seed, 500" in page and "4 runs: 1 to 3 training seeds, 500" in page
    assert "--rung pair --primitives 500 --rooms 3 --runs 1\n" in page
    assert "--rung chain-3 --primitives 500 --rooms 3 --runs 3\n" in page


@pytest.mark.nightly
def test_learners_from_many_rooms_at_once_stand_in_the_place_of_those_from_one(tmp_path: Path):
    many = dataclasses.replace(LINE, agent=MEMORY + AT_ONCE, primitives=1_000_000, efficiency=0.8)
    lines = [LINE, dataclasses.replace(LINE, agent=MEMORY, efficiency=0.4), many]
    page = tell("generalisation", lines, tmp_path)
    assert "options, objects, memory 0.80 with 1" in page and f"| `{MEMORY}` | 0.80 (1.00) |" in page
    assert "2 runs: 1 training seed, 500 and 1,000,000 primitives" in page and "for some learners." in page
    assert "Those of 1,000,000 primitives are learned from 256 rooms at once" in page and "0.40" not in page
    assert "--part many --rung pair --primitives 1000000 --rooms 3 --runs 1 --workers 2\n" in page
    assert "--part sizes --rung pair --primitives 500 --rooms 3 --runs 1\n" in page
    alone = tell("generalisation", [many], tmp_path)
    assert "--part sizes" not in alone and "That is less" not in alone
    deeper = [dataclasses.replace(line, protocol="depth", rung="8 buttons, layered", rooms="a > b") for line in lines]
    page = tell("generalisation", deeper, tmp_path)
    assert f"| `{MEMORY}` | - | - | 0.80 | - | 1.00 |" in page and "--part many-depth --primitives 1000000" in page
    other = dataclasses.replace(LINE, agent=MEMORY, rung="chain-3", efficiency=0.3)
    assert "0.30 (1.00)" in tell("generalisation", [*lines, other], tmp_path), "of another rung"


@pytest.mark.slow
def test_many_rooms_at_once_teach_what_helps_in_unseen_ones():
    short, longer = (run_many("ladder-1", "chain-3", MEMORY, 16, 0, primitives, 8) for primitives in (2_000, 200_000))
    assert longer.efficiency > short.efficiency + 0.1 and longer.escapes == 1.0
    assert longer.rooms == "ladder-1/chain-3/train#0..16 > ladder-1/chain-3/test#0..8"
    assert longer.agent == MEMORY + AT_ONCE


@pytest.mark.slow
def test_what_many_rooms_at_once_teach_helps_in_deeper_ones():
    short, longer = (run_course("ladder-1", TRAINED, MEMORY, 0, primitives, 64, 8) for primitives in (2_000, 300_000))
    assert [line.rung for line in longer] == list(DEPTHS) and all(line.protocol == "depth" for line in longer)
    assert all(after.efficiency > before.efficiency + 0.1 for before, after in zip(short, longer, strict=True))
    across = run_course("ladder-1", "pair", MEMORY, 0, 100_000, 16, 4)
    assert [line.rung for line in across] == list(TRANSFER) and across[0].efficiency > 0.5
    assert across[-1].rooms == "ladder-1/pair/train#0..16 > ladder-1/lattice/test#0..4" and across[-1].efficiency > 0.1
    (name,) = CEILING
    assert run_reference("ladder-1", "pair", name, 4).efficiency > across[0].efficiency - 0.2
    for agent in (FLAT, VECTORS):
        assert run_many("ladder-1", "pair", agent, 4, 0, 2_000, 2).agent == agent + AT_ONCE


def make_transfers(means: dict[tuple[str, str], float], searcher: float = 0.6) -> list[BaselineRun]:
    """Ten seeds a pair of rungs around 0.5, or these means, with searchers beside them."""
    rng = np.random.default_rng(0)
    known = [dataclasses.replace(LINE, protocol="transfer", rung=rung, agent=agent, primitives=0,
                                 efficiency=searcher - 0.1 * number)
             for rung in TRANSFER for number, agent in enumerate(SEARCH_BASELINES)]
    return known + [
        dataclasses.replace(LINE, protocol="transfer", rung=target, agent=MEMORY + AT_ONCE, seed=seed, primitives=1_000,
                            rooms=f"ladder-1/{source}/train#0..8 > ladder-1/{target}/test#0..4",
                            efficiency=means.get((source, target), 0.5) + 0.01 * rng.normal())
        for source in TRANSFER for target in TRANSFER for seed in range(10)]


def tell_across(means: dict[tuple[str, str], float], searcher: float = 0.6) -> list[str]:
    found = read_transfers(make_transfers(means, searcher))
    assert found is not None
    return tell_transfers(found)


def test_other_rungs_are_told_by_what_was_learned_there_and_beside_searching():
    assert tell_across({}) == [
        "It reaches more than the best searcher in none of 5 rungs that it was trained in and in none of 20 pairs with "
        "another rung, and less in 25 of 25 pairs.",
        "Of 20 pairs of two rungs, training in the other loses in 0, and gains in none."]
    home = {(rung, rung): 0.9 for rung in TRANSFER}
    beyond, across = tell_across(home | {("pair", "chain"): 0.95})
    assert beyond.startswith("It reaches more than the best searcher in 5 rungs of 5 that it was trained in (`pair`, ")
    assert "in 1 of 20 pairs with another rung (`pair` to `chain`), and less in 19 of 25 pairs." in beyond
    assert across == ("Of 20 pairs of two rungs, training in the other loses in 19, and gains in 1: `chain` is learned "
                      "better in `pair`.")
    assert "less in 0 of 25 pairs" in tell_across({}, searcher=0.5)[0]
    lines = [dataclasses.replace(line, efficiency=0.1) if line.rung == "pair" and not line.primitives else line
             for line in make_transfers({})]
    found = read_transfers(lines)
    assert found is not None
    told = tell_transfers(found)[0]
    assert "it was trained in (`pair`) and in 4 of 20 pairs" in told
    assert "`lattice` to `pair`" in told and "`pair` to `lattice`" not in told, "the searcher of the rung tested in"


@pytest.mark.nightly
def test_other_rungs_are_told_once_all_are_there(tmp_path: Path):
    lines = make_transfers({("chain", "lattice"): 0.8})
    page = tell("generalisation", [LINE, *lines], tmp_path)
    assert "| trained in `chain` | 0.5" in page and page.count("| 0.8") == 1
    assert "| the best searcher | 0.60 | 0.60 |" in page
    assert "--part transfer --primitives 1000 --rooms 3 --runs 10" in page
    assert (tmp_path / "figures" / "transfer.svg").stat().st_size > 1000
    assert read_transfers(lines[:-1]) is None and read_transfers(lines[len(SEARCH_BASELINES):]) is None
    assert "Other rungs" not in tell("generalisation", [LINE, *lines[:-1]])


def make_seeds(agent: str, rooms: int, efficiency: float, shift: int, **fields: Any) -> list[BaselineRun]:
    """Lines of ten seeds around an efficiency, by amounts that are shifted from seed to seed."""
    return [dataclasses.replace(LINE, agent=agent, rooms=f"x/train#0..{rooms} > x/test", seed=seed,
                                efficiency=efficiency + 0.01 * ((3 * seed + shift) % 10 - 4.5), **fields)
            for seed in range(10)]


@pytest.mark.nightly_for(
    "memory1-0.6-Give a generalist more training rooms (+0.50) before a memory of its episode (+0.10).")
@pytest.mark.parametrize(("memory", "objects", "words"), [
    ((0.6, 0.7), 0.2, "Give a generalist a memory of its episode (+0.50) before more training rooms (+0.10)."),
    ((0.2, 0.7), 0.6, "Give a generalist more training rooms (+0.50) before a memory of its episode (+0.10)."),
    ((0.7, 0.7), 0.2, "Give a generalist a memory of its episode (+0.50)."),
    ((0.4, 0.4), 0.4, "Neither a memory of its episode nor more training rooms are shown to help a generalist."),
])
def test_advice_follows_memory_and_rooms(memory: tuple[float, float], objects: float, words: str):
    lines = [line for number, (agent, rooms, value) in enumerate((
        (MEMORY, 1, memory[0]), (MEMORY, 1000, memory[1]), (OBJECTS, 1, objects), (OBJECTS, 1000, objects)))
        for line in make_seeds(agent, rooms, value, 3 * number)]
    assert words in tell("generalisation", lines)


@pytest.mark.parametrize(("vectors", "objects", "told"), [
    ((0.2, 0.2), (0.5, 0.7), (f"- `{OBJECTS}` with 1,000 training rooms reaches 0.50 more than `{VECTORS}` (",
                              f"- `{OBJECTS}` with 1,000 training rooms reaches 0.20 more than with 1 training room (",
                              f"- `{OBJECTS}` with 1,000 training rooms reaches 0.40 more than random choices (",
                              f"- `{VECTORS}` with 1,000 training rooms is not shown to reach more or less than with 1",
                              f"- `{VECTORS}` with 1,000 training rooms reaches 0.10 less than random choices (")),
    ((0.4, 0.6), (0.6, 0.3), (f"- `{OBJECTS}` with 1,000 training rooms reaches 0.30 less than `{VECTORS}` (",
                              f"- `{OBJECTS}` with 1,000 training rooms reaches 0.30 less than with 1 training room (",
                              f"- `{OBJECTS}` with 1,000 training rooms is not shown to reach more or less than random",
                              f"- `{VECTORS}` with 1,000 training rooms reaches 0.20 more than with 1 training room (",
                              f"- `{VECTORS}` with 1,000 training rooms reaches 0.30 more than random choices (")),
])
def test_ten_seeds_lead_to_sentences_and_nine_to_none(vectors: tuple, objects: tuple, told: tuple):
    lines = [*make_seeds(CHANCE, 1, 0.3, 0, primitives=0)]
    for agent, values in ((VECTORS, vectors), (OBJECTS, objects)):
        for rooms, value in zip((1, 1000), values, strict=True):
            lines += make_seeds(agent, rooms, value, 1 + len(lines) // 10)
    page = tell("generalisation", lines)
    assert not [words for words in told if words not in page], page
    assert page.count("\n- ") == len(told)
    for sentence in (line for line in page.splitlines() if line.startswith("- ")):
        if " more than " in sentence or (" less than " in sentence and "not shown" not in sentence):
            low, high = map(float, re.findall(r"\((\S+) to (\S+)\)", sentence)[0])
            assert 0 < low < float(re.findall(r"reaches (\S+)", sentence)[0]) < high, sentence
    few = [line for line in lines if (line.agent, line.seed) != (OBJECTS, 9)]
    page = tell("generalisation", few)
    assert f"- `{OBJECTS}`" not in page and page.count("\n- ") == 2
    assert f"| `{OBJECTS}` | {objects[0]:.2f} (" in page and f"| `{VECTORS}` | **{vectors[0]:.2f}** (" in page
    assert "9 to 10 training seeds" in page and "Nothing is concluded from fewer than 10" in page


def test_an_agent_at_the_floor_is_told_of_alone_and_flat_chance_is_that_over_primitives():
    flat = [dataclasses.replace(LINE, agent=FLAT, rooms=f"x/train#0..{rooms} > x/test", seed=seed, efficiency=0.0,
                                seen=0.0) for rooms in (1, 1000) for seed in range(10)]
    others = [*make_seeds(VECTORS, 1000, 0.3, 0), *make_seeds(CHANCE, 1, 0.4, 3, primitives=0)]
    page = tell("generalisation", [*flat, *others])
    assert (f"- `{FLAT}` escapes from no unseen room after any of its 20 runs, trained in 1 or 1,000 rooms, nor from "
            "one trained in. At this floor no difference from it is asked for.") in page
    assert page.count("\n- ") == 2 and f"- `{VECTORS}` with 1,000 training rooms reaches 0.10 less than random" in page
    page = tell("generalisation", [dataclasses.replace(flat[0], seen=0.7), *flat[1:], *others])
    assert "though in rooms trained in a run reaches up to 0.70. At this floor" in page
    above = [dataclasses.replace(line, efficiency=0.02 + 0.001 * line.seed) for line in flat]
    by_chance = [dataclasses.replace(line, agent=FLAT_CHANCE, primitives=0) for line in flat[:10]]
    page = tell("generalisation", [*above, *others, *by_chance])
    assert f"- `{FLAT}` with 1,000 training rooms reaches 0.02 more than random primitives (" in page
    assert f"- `{VECTORS}` with 1,000 training rooms reaches 0.28 more than `{FLAT}` (" in page and "floor" not in page


@pytest.mark.parametrize(("chain", "deepest", "told"), [
    (0.3, 0.2, ("one chain reaches 0.30 less than in rooms of 6 buttons, layered",
                "10 buttons, layered reaches 0.40 less than in")),
    (0.6, 0.8, ("one chain is not shown to reach more or less than in rooms of 6 buttons, layered",
                "10 buttons, layered reaches 0.20 more than in")),
    (0.7, 0.6, ("one chain reaches 0.10 more than in rooms of 6 buttons, layered",
                "10 buttons, layered is not shown to reach more or less than in rooms of 6 buttons, layered"))])
def test_depth_is_told_at_an_equal_number_of_buttons(chain: float, deepest: float, told: tuple):
    values = dict(zip(DEPTHS, (0.6, chain, 0.5, deepest), strict=True))
    lines = [line for shift, (rung, value) in enumerate(values.items())
             for line in make_seeds(MEMORY, 1, value, shift, protocol="depth", rung=rung)]
    page = tell("generalisation", lines)
    assert not [words for words in told if words not in page], page
    assert page.count(f"\n- `{MEMORY}` in rooms of ") == 2
    assert f"| **{chain:.2f}** |" in page and "| **0.50** |" in page
    lines += [line for rung, shift in (("6 buttons, layered", 5), ("8 buttons, layered", 6))
              for line in make_seeds(CHANCE, 1, 0.5, shift, protocol="depth", rung=rung, primitives=0)]
    page = tell("generalisation", lines)
    assert f"- `{MEMORY}` in rooms of 6 buttons, layered reaches 0.10 more than random choices (" in page
    assert f"- `{MEMORY}` in rooms of 8 buttons, layered is not shown to reach more or less than random choices" in page
    assert page.count(f"\n- `{MEMORY}` in rooms of ") == 4 and f"- `{CHANCE}`" not in page


def test_a_difference_by_luck_alone_is_not_told_where_many_are_asked_about():
    """One question of p = 0.03 is answered; among five, Holm's correction leaves it open."""
    gains = [0.12, -0.02, 0.1, 0.03, -0.04, 0.14, 0.07, -0.03, 0.05, 0.06]
    lines = [*make_seeds(VECTORS, 1, 0.5, 0)]
    lines += [dataclasses.replace(line, rooms="x/train#0..16 > x/test", efficiency=line.efficiency + gain)
              for line, gain in zip(lines, gains, strict=True)]
    assert "with 16 training rooms reaches 0.05 more than with 1" in tell("generalisation", lines)
    others = [*make_seeds(CHANCE, 1, 0.5, 2), *make_seeds(OBJECTS, 1, 0.5, 2), *make_seeds(OBJECTS, 16, 0.5, 4)]
    page = tell("generalisation", [*lines, *others])
    assert f"`{VECTORS}` with 16 training rooms is not shown to reach more or less than with 1 training room" in page


@pytest.mark.parametrize(("learner", "nearest", "told"), [
    (0.6, 0.8, ("**No learner matches searching in `pair`: ",
                "reaches 0.20 less than the best searcher, `search-nearest")),
    (0.8, 0.6, ("**In these rooms of `pair`, training pays beyond searching in 1 of 1 cells: ",
                "reaches 0.20 more than the best searcher, `search-nearest")),
    (0.7, 0.7, ("**No learner is shown to beat searching in `pair`: ",
                "is not shown to reach more or less than the best se"))])
def test_learners_are_held_against_the_best_searcher_and_not_against_chance(learner: float, nearest: float,
                                                                            told: tuple):
    untried, near = SEARCH_BASELINES
    lines = [*make_seeds(MEMORY, 1000, learner, 2), *make_seeds(CHANCE, 1, 0.3, 5, primitives=0),
             *make_seeds(untried, 1, nearest - 0.1, 4, primitives=0), *make_seeds(near, 1, nearest, 6, primitives=0)]
    page = tell("generalisation", lines)
    assert not [words for words in told if words not in page] and "Bayes planner" not in page, page
    (ceiling,) = CEILING
    page = tell("generalisation", [*lines, *make_seeds(ceiling, 1, 0.9, 6, primitives=0)])
    assert not [words for words in told if words not in page], "nobody is held against who knows more than searchers"
    assert f"The Bayes planner, `{ceiling}`, is given how graphs are drawn and has 0.90" in page
    assert "than random choices" not in page
    depths = [dataclasses.replace(line, protocol="depth", rung="6 buttons, layered") for line in lines]
    page = tell("generalisation", [*lines, *depths])
    assert f"- `{MEMORY}` in rooms of 6 buttons, layered {told[1]}" in page and "than random choices" not in page


def test_the_best_of_several_cells_is_corrected_for_the_choice():
    """One cell whose gain over the searcher has p = 0.03 is a finding, the best of five of its kind is none."""
    gains = [0.12, -0.02, 0.1, 0.03, -0.04, 0.14, 0.07, -0.03, 0.05, 0.06]
    _, near = SEARCH_BASELINES
    searched = make_seeds(near, 1, 0.5, 0, primitives=0)

    def train_in(rooms: int, shift: int) -> list[BaselineRun]:
        return [dataclasses.replace(line, agent=MEMORY, rooms=f"x/train#0..{rooms} > x/test", primitives=500,
                                    efficiency=line.efficiency + gains[(line.seed + shift) % 10]) for line in searched]

    said = tell("generalisation", [*searched, *train_in(16, 0)])
    assert "**In these rooms of `pair`, training pays beyond searching in 1 of 1 cells: " in said
    assert f"`{MEMORY}` with 16 training rooms reaches" in said and "in 3 unseen rooms, the best" in said
    assert "(+0.05, +0.00 to +0.09 over training seeds in these rooms)" in said
    other = tell("generalisation", [dataclasses.replace(line, rung="chain", episodes=7)
                                    for line in [*searched, *train_in(16, 0)]])
    assert "In these rooms of `chain`, training pays" in other and "in 7 unseen rooms, the best" in other
    several = [line for shift, rooms in enumerate((1, 4, 16, 64, 256)) for line in train_in(rooms, shift)]
    said = tell("generalisation", [*searched, *several])
    assert f"`{MEMORY}` at its best number of training rooms, " in said, "the number was chosen after a look"
    assert "**No learner is shown to beat searching in `pair`: " in said and "80 % power to detect a gain of 0." in said
