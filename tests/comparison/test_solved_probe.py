"""Recovery of a graph: edges that matter, precision and recall, and the longest chain."""

from hrl_escape.comparison.solved_probe import compare_graphs, find_edges_that_matter
from studies.scaling.results import compute_edge_depth


def test_an_edge_that_a_longer_way_implies_does_not_matter():
    assert find_edges_that_matter([(0, 1), (1, 2), (0, 2)], goals=[2]) == {(0, 1), (1, 2)}


def test_edges_to_what_no_goal_needs_do_not_matter():
    assert find_edges_that_matter([(0, 1), (0, 3), (3, 4), (1, 2)], goals=[2]) == {(0, 1), (1, 2)}
    assert find_edges_that_matter([(0, 1), (0, 3), (3, 4), (1, 2)], goals=[2, 3]) == {(0, 1), (1, 2), (0, 3)}
    assert find_edges_that_matter([(0, 1)], goals=[0]) == set()


def test_a_believed_graph_may_have_cycles():
    found = find_edges_that_matter([(0, 1), (1, 0), (1, 2)], goals=[2])
    assert found == {(0, 1), (1, 0), (1, 2)}


def test_precision_and_recall_of_edges():
    true = frozenset({(0, 1), (1, 2)})
    assert compare_graphs(frozenset({(0, 1), (0, 2), (5, 6), (7, 8)}), true) == (0.25, 0.5)
    assert compare_graphs(frozenset(), true) == (0.0, 0.0)
    assert compare_graphs(frozenset(), frozenset()) == (1.0, 1.0)


def test_depth_counts_the_edges_in_a_row_that_lead_to_a_goal():
    assert compute_edge_depth([(0, 1), (1, 2), (3, 2), (2, 4), (5, 6)], goals=[4]) == 3
    assert compute_edge_depth([(0, 1)], goals=[0]) == 0
