"""Canonical forms: equal for relabelled graphs, different for others, counted against the known numbers of DAGs."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.sets.keys import compute_canonical_form


def relabel(colours, edges, label):
    moved = [0] * len(colours)
    for node, colour in enumerate(colours):
        moved[label[node]] = colour
    return moved, [(label[a], label[b]) for a, b in edges]


@st.composite
def graphs(draw, most=8):
    count = draw(st.integers(1, most))
    pairs = [(i, j) for j in range(count) for i in range(j)]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    return draw(st.lists(st.integers(0, 1), min_size=count, max_size=count)), edges


@pytest.mark.nightly
@given(graphs(), st.data())
def test_relabelling_keeps_the_form(graph, data):
    label = data.draw(st.permutations(range(len(graph[0]))))
    assert compute_canonical_form(*graph) == compute_canonical_form(*relabel(*graph, label))


@pytest.mark.nightly
@given(graphs())
def test_the_form_is_a_relabelling_of_the_graph(graph):
    colours, edges = compute_canonical_form(*graph)
    if len(colours) > 5:
        assert sorted(colours) == sorted(graph[0]) and len(edges) == len(graph[1])
        return
    assert any(sorted(relabel(*graph, label)[1]) == list(edges) and relabel(*graph, label)[0] == list(colours)
               for label in itertools.permutations(range(len(colours))))


@pytest.mark.parametrize(("count", "classes"), [(1, 1), (2, 2), (3, 6), (4, 31), (5, 302)])
def test_there_are_as_many_forms_as_unlabelled_dags(count, classes):
    """OEIS A003087."""
    pairs = [(i, j) for j in range(count) for i in range(j)]
    forms = {compute_canonical_form([0] * count, [pair for pair, kept in zip(pairs, chosen, strict=True) if kept])
             for chosen in itertools.product((False, True), repeat=len(pairs))}
    assert len(forms) == classes


@pytest.mark.nightly_for("edges2", "edges0")
@pytest.mark.parametrize("edges", [
    [(i, 15) for i in range(15)],
    [(2 * i, 2 * i + 1) for i in range(8)],
    [],
    [(i, 8 + (i + k) % 8) for i in range(8) for k in range(3)],
])
def test_symmetric_graphs_of_16_nodes_take_no_factorial_time(edges):
    form = compute_canonical_form([0] * 16, edges)
    assert compute_canonical_form(*relabel([0] * 16, edges, list(range(15, -1, -1)))) == form
