"""Slow directions and what options along them do to a random walk: diffusion, hitting and cover times in Four Rooms."""

import numpy as np
import pytest
from scipy import sparse

from hrl_escape.agents.discovery import (
    NOTHING,
    StateModel,
    compute_laplacian,
    compute_successor_representation,
    find_covering_edge,
    find_slow_directions,
    find_slow_directions_of_successors,
    make_eigenoption,
    make_point_option,
)
from tests.classic.diffusion import compute_diffusion_time, make_next_states, sample_cover_time
from tests.classic.four_rooms import GRID, FourRooms

TABLES = FourRooms(None, "none").make_tables()
AFTER = make_next_states(TABLES)
MODEL = StateModel(sparse.csr_matrix(TABLES.probability.reshape(416, 104)), np.ones((104, 4), np.bool_))
ADJACENCY = (TABLES.probability.sum(axis=1) > 0) & ~np.eye(104, dtype=bool)
ADJACENCY = ADJACENCY.astype(float)


def make_options(directions, signs=(1.0, -1.0)):
    vectors = directions.vectors.T
    return [make_eigenoption(str(n), MODEL, sign * v, 0.9) for n, v in enumerate(vectors) for sign in signs]


# --- directions ---------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["random-walk", "normalised", "combinatorial"])
def test_directions_are_eigenvectors_the_slowest_first_without_the_constant_one(kind):
    laplacian = compute_laplacian(ADJACENCY, kind)
    values, vectors = find_slow_directions(ADJACENCY, 103, kind)
    np.testing.assert_allclose(laplacian @ vectors, vectors * values, atol=1e-12)
    assert (np.diff(values) > -1e-12).all() and values[0] > 1e-3
    expected = {"combinatorial": 0.022903}.get(kind, 0.007007)
    assert values[0] == pytest.approx(expected, abs=5e-7)
    if kind == "random-walk":
        np.testing.assert_allclose(laplacian.sum(axis=1), 0, atol=1e-12)


def test_successors_of_the_uniform_walk_have_the_directions_of_the_combinatorial_laplacian():
    """It stays where a wall is in the way, so that P = I - L / 4."""
    walk = TABLES.probability.mean(axis=1)
    successors = compute_successor_representation(walk, 0.9)
    visits = sum(0.9**t * np.linalg.matrix_power(walk, t) for t in range(250))
    np.testing.assert_allclose(successors, visits, atol=1e-9)
    exact = find_slow_directions(ADJACENCY, 8, "combinatorial")
    found = find_slow_directions_of_successors(successors, 8)
    np.testing.assert_allclose(found.eigenvalues, 1 - 0.9 * (1 - exact.eigenvalues / 4), atol=1e-9)
    overlaps = np.abs((found.vectors * exact.vectors).sum(axis=0)) / np.linalg.norm(found.vectors, axis=0)
    np.testing.assert_allclose(overlaps, 1.0, atol=1e-6)


# --- eigenoptions -------------------------------------------------------------------------


def test_an_eigenoption_climbs_to_a_local_peak_of_its_purpose_and_ends_there():
    purpose = find_slow_directions(ADJACENCY, 1, "random-walk").vectors[:, 0]
    up, down = make_eigenoption("up", MODEL, purpose, 0.9), make_eigenoption("down", MODEL, -purpose, 0.9)
    for option, sign in ((up, 1.0), (down, -1.0)):
        (ends,) = np.flatnonzero(option.actions == NOTHING)
        assert ends == (sign * purpose).argmax()
        assert (option.starts == (option.actions != NOTHING)).all()
        for state in range(104):
            earned, discount, steps = 0.0, 1.0, 0
            while option.actions[state] != NOTHING:
                after = AFTER[state, option.actions[state]]
                earned += discount * sign * (purpose[after] - purpose[state])
                state, discount, steps = after, 0.9 * discount, steps + 1
            assert state == ends and steps < 40 and (earned > 0) == (steps > 0)


@pytest.mark.nightly_for("normalised-8-667.47-111.34", "combinatorial-8-267.11-33.3", "random-walk-8-206.98-28.14")
@pytest.mark.parametrize(("kind", "directions", "primitives", "decisions"), [
    ("normalised", 0, 620.769, 620.769),
    ("normalised", 1, 607_789, 163_420),
    ("combinatorial", 1, 2_622_570, 593_615),
    ("normalised", 8, 667.47, 111.34),
    ("combinatorial", 8, 267.11, 33.30),
    ("random-walk", 8, 206.98, 28.14),
])
def test_few_eigenoptions_make_a_walk_far_slower_and_more_of_them_faster(kind, directions, primitives, decisions):
    """Every time is a linear solve; with all options and the rest of the kinds in docs/agents/eigenoptions.md."""
    options = make_options(find_slow_directions(ADJACENCY, directions, kind))
    found = compute_diffusion_time(AFTER, options)
    assert found == pytest.approx((primitives, decisions), rel=1e-3)


@pytest.mark.nightly
def test_one_sign_alone_does_not_do():
    directions = find_slow_directions(ADJACENCY, 8, "random-walk")
    both, one = (compute_diffusion_time(AFTER, make_options(directions, signs))[0] for signs in ((1, -1), (1,)))
    assert one > 2 * both


# --- covering options ---------------------------------------------------------------------


@pytest.mark.nightly
def test_edges_join_the_corners_and_raise_the_algebraic_connectivity():
    joined, connectivity, edges = ADJACENCY.copy(), [], []
    for _ in range(4):
        connectivity.append(np.linalg.eigvalsh(compute_laplacian(joined, "normalised"))[1])
        ends = find_covering_edge(joined)
        edges.append({GRID.cells[end] for end in ends})
        joined[ends], joined[ends[::-1]] = 1.0, 1.0
    assert connectivity[:2] == pytest.approx([0.007007, 0.008486], abs=5e-7)
    assert edges[:2] == [{(11, 1), (1, 11)}, {(1, 1), (11, 11)}]
    assert all(later > earlier for earlier, later in zip(connectivity, connectivity[1:], strict=False))
    assert connectivity[2] > 2 * connectivity[0]
    hitting = [compute_hitting_time(graph) for graph in (ADJACENCY, joined)]
    assert hitting[1] < 0.8 * hitting[0]
    cover = [sample_cover_time(graph, np.random.default_rng(0), 60) for graph in (ADJACENCY, joined)]
    assert cover[0] == pytest.approx(2142, rel=0.15) and cover[1] < 0.85 * cover[0]


def compute_hitting_time(adjacency):
    """Mean over ordered pairs of the simple walk's expected steps, by one linear solve a goal."""
    walk = adjacency / adjacency.sum(axis=1, keepdims=True)
    total = 0.0
    for goal in range(len(walk)):
        keep = np.arange(len(walk)) != goal
        total += np.linalg.solve(np.eye(len(walk) - 1) - walk[np.ix_(keep, keep)], np.ones(len(walk) - 1)).sum()
    return total / (len(walk) * (len(walk) - 1))


def test_a_point_option_begins_in_one_state_and_walks_the_shortest_way_to_the_other():
    start, goal = GRID.numbers[11, 1], GRID.numbers[1, 11]
    option = make_point_option("across", MODEL, start, goal)
    assert np.flatnonzero(option.starts).tolist() == [start]
    steps, state = 0, start
    while option.actions[state] != NOTHING:
        state, steps = AFTER[state, option.actions[state]], steps + 1
    assert (state, steps) == (goal, 20)


def test_a_goal_that_no_known_action_leads_to_makes_no_option():
    follow = sparse.csr_matrix(np.array([[1.0, 0.0], [0.0, 0.0]]))
    option = make_point_option("none", StateModel(follow, np.array([[True], [False]])), 0, 1)
    assert not option.starts.any() and (option.actions == NOTHING).all()
