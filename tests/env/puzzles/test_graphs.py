"""Button graphs: the published code's draws, and the shape of every family."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.puzzles.graphs import GRAPH_KINDS, GraphConfig, compute_order, sample_graph, sample_larg_graph
from hrl_escape.errors import ConfigError

PUBLISHED = json.loads((Path(__file__).parents[2] / "data" / "larg2019_graphs.json").read_text())


def test_larg_graphs_equal_the_published_codes_output_for_every_recorded_key():
    assert len(PUBLISHED) == 1400
    for key, parents in PUBLISHED.items():
        size, seed, complexity = map(int, key.split(","))
        edges = sample_larg_graph(size, seed, complexity)
        drawn = [[parent for parent, child in edges if child == button] for button in range(size)]
        assert drawn == parents, key


@given(st.sampled_from([k for k in GRAPH_KINDS if k != "edges"]), st.integers(1, 64), st.integers(1, 6),
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


def test_order_is_topological_and_prefers_small_numbers():
    assert compute_order(4, ((3, 0), (1, 2))) == (1, 2, 3, 0)


def test_a_cycle_is_refused_and_shown():
    with pytest.raises(ConfigError, match=r"\[0, 1, 2\].*cycles"):
        compute_order(4, ((0, 1), (1, 2), (2, 0)))


def test_an_edge_to_no_button_is_refused():
    with pytest.raises(ConfigError, match="from 0 to 2"):
        compute_order(3, ((0, 3),))
