"""Button graphs: the published code's draws, and the shape of every family."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig, GraphKind, compute_order, sample_graph, sample_larg_graph
from hrl_escape.errors import ConfigError

PUBLISHED = json.loads((Path(__file__).parents[2] / "data" / "larg2019_graphs.json").read_text())


def test_larg_graphs_equal_the_published_codes_output_for_every_recorded_key():
    assert len(PUBLISHED) == 1400
    for key, parents in PUBLISHED.items():
        size, seed, complexity = map(int, key.split(","))
        edges = sample_larg_graph(size, seed, complexity)
        drawn = [[parent for parent, child in edges if child == button] for button in range(size)]
        assert drawn == parents, key


@given(st.sampled_from([k for k in get_args(GraphKind) if k != "edges"]), st.integers(1, 64), st.integers(1, 6),
       st.integers(0, 2**32))
def test_every_family_gives_an_acyclic_graph_within_its_parent_limit(kind, count, parents, seed):
    edges = sample_graph(GraphConfig(kind=kind, max_parents=parents), count, np.random.default_rng(seed))
    assert sorted(compute_order(count, edges)) == list(range(count))
    assert all(parent < child for parent, child in edges)
    assert len(set(edges)) == len(edges)
    degree = [sum(child == node for _, child in edges) for node in range(count)]
    assert max(degree) <= (1 if kind in ("chain", "tree") else parents)
    if kind in ("chain", "tree"):
        assert degree == [0] + [1] * (count - 1)


@pytest.mark.parametrize("kind", ["layered", "random"])
def test_buttons_have_every_number_of_parents_up_to_the_limit(kind):
    counts = set()
    for seed in range(50):
        edges = sample_graph(GraphConfig(kind=kind, max_parents=3), 24, np.random.default_rng(seed))
        counts |= {sum(child == node for _, child in edges) for node in range(24)}
    assert counts == {0, 1, 2, 3}


def test_order_is_topological_and_prefers_small_numbers():
    assert compute_order(4, ((3, 0), (1, 2))) == (1, 2, 3, 0)


def test_a_cycle_is_refused_and_shown():
    with pytest.raises(ConfigError, match=r"\[0, 1, 2\].*cycles"):
        compute_order(4, ((0, 1), (1, 2), (2, 0)))


def test_an_edge_to_no_button_is_refused():
    with pytest.raises(ConfigError, match="from 0 to 2"):
        compute_order(3, ((0, 3),))


# --- relabelling -----------------------------------------------------------------------------

GENERATED = [GraphConfig(kind=kind, max_parents=3, relabel=relabel)
             for kind in ("chain", "tree", "layered", "random") for relabel in (True, False)]


def draw_puzzles(relabel: bool) -> list[ButtonsPuzzle]:
    configs = [ButtonsConfig(count=8, graph=graph) for graph in GENERATED if graph.relabel == relabel]
    return [config.make_puzzle(np.random.default_rng(seed)) for config in configs for seed in range(100)]


def solves(puzzle: ButtonsPuzzle, order) -> bool:
    state = puzzle.make_state()
    for button in order:
        state = puzzle.update(state, Contacts((int(button),)))
    return puzzle.is_solved(state)


def test_pressing_in_index_order_solves_no_more_relabelled_graphs_than_a_random_order_does():
    rng = np.random.default_rng(0)
    puzzles = draw_puzzles(relabel=True)
    chance = sum(solves(puzzle, rng.permutation(8)) for puzzle in puzzles for _ in range(25)) / 25
    assert chance < 100
    assert sum(solves(puzzle, range(8)) for puzzle in puzzles) <= chance + 3 * np.sqrt(chance)


def test_without_relabelling_index_order_solves_every_graph():
    assert all(solves(puzzle, range(8)) for puzzle in draw_puzzles(relabel=False))


def test_relabelling_changes_numbers_only():
    for plain, shuffled in zip(draw_puzzles(relabel=False), draw_puzzles(relabel=True), strict=True):
        assert describe_shape(plain) == describe_shape(shuffled)


def describe_shape(puzzle: ButtonsPuzzle):
    """Numbers of parents and children of each button, and those of the goal."""
    degrees = [(sum(p == i for p, _ in puzzle.edges), sum(c == i for _, c in puzzle.edges))
               for i in range(puzzle.count)]
    return sorted(degrees), degrees[puzzle.goal]


def test_explicit_edges_keep_their_numbers():
    graph = GraphConfig(kind="edges", edges=((0, 1), (1, 2)))
    for seed in range(20):
        puzzle = ButtonsConfig(count=3, graph=graph).make_puzzle(np.random.default_rng(seed))
        assert (puzzle.edges, puzzle.goal) == (((0, 1), (1, 2)), 2)
