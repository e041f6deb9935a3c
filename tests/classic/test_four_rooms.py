"""Four Rooms: its map, its slips, planning with hallway options."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chisquare

from tests.classic.exact import (
    count_primitives,
    evaluate,
    find_fewest_primitives,
    find_values,
    make_model,
    make_option_model,
    make_primitive_options,
    make_uniform_policy,
)
from tests.classic.four_rooms import (
    EAST_HALLWAY,
    GRID,
    HALLWAYS,
    NORTH_HALLWAY,
    ROOMS,
    SOUTH_EAST_GOALS,
    SOUTH_HALLWAY,
    FourRooms,
    make_hallway_options,
    make_room_mask,
)
from tests.classic.tabular import State

SLIPS = ("none", "extra", "neighbour", "direction")
GAMMA = 0.9


def compute_distances():
    """Moves between every two cells, by one backward search from each."""
    distances = np.full((len(GRID), len(GRID)), -1)
    for goal in range(len(GRID)):
        distances[goal, goal], front = 0, [goal]
        for cell in front:
            for there in GRID.list_neighbours(cell):
                if distances[there, goal] < 0:
                    distances[there, goal] = distances[cell, goal] + 1
                    front.append(there)
    return distances


# --- the map ---------------------------------------------------------------------------


def test_the_map_has_four_rooms_and_four_hallways():
    rooms = [make_room_mask(room) for room in ROOMS]
    assert [room.sum() for room in rooms] == [25, 30, 25, 20]
    assert sum(rooms).max() == 1  # no cell in two
    np.testing.assert_array_equal(np.flatnonzero(sum(rooms) == 0), HALLWAYS)
    assert all(len(GRID.list_neighbours(hallway)) == 2 for hallway in HALLWAYS)
    assert sum(len(GRID.list_neighbours(cell)) for cell in range(len(GRID))) == 2 * 168


def test_distances_of_the_map():
    distances = compute_distances()
    assert distances.max() == 20
    assert distances.sum() / (104 * 103) == pytest.approx(8.5836, abs=5e-5)
    np.testing.assert_allclose(find_fewest_primitives(FourRooms(62, "none").make_tables()), distances[:, 62])


@pytest.mark.parametrize(
    "normalised, published",
    [
        (True, [0.007007, 0.008495, 0.017414, 0.093982, 0.119292]),
        (False, [0.022903, 0.027156, 0.056157, 0.284739, 0.352017]),
    ],
)
def test_the_graph_has_three_slow_directions(normalised, published):
    adjacent = (compute_distances() == 1).astype(float)
    degrees = adjacent.sum(axis=1)
    laplacian = np.diag(degrees) - adjacent
    if normalised:
        laplacian /= np.sqrt(np.outer(degrees, degrees))
    np.testing.assert_allclose(np.linalg.eigvalsh(laplacian)[1:6], published, atol=5e-7)


def test_the_diffusion_time_of_primitives():
    """Mean over ordered pairs of the random walk's expected primitives from one cell to another."""
    total = 0.0
    for goal in range(len(GRID)):
        model = make_model(count_primitives(FourRooms(goal, "none").make_tables()), 1.0)
        total += evaluate(model, make_uniform_policy(model)).sum()
    assert total / (104 * 103) == pytest.approx(620.769, abs=5e-4)


# --- the slips -------------------------------------------------------------------------


@pytest.mark.nightly_for("none-7.592-502.4-8.694-0.93654")
@pytest.mark.parametrize(
    "slip, optimum, random_walk, moved_goals, value",
    [
        ("none", 7.592, 502.4, 8.694, 0.93654),
        ("extra", 8.392, 430.2, 9.499, 0.92921),
        ("neighbour", 12.056, 459.4, 13.758, 0.89702),
        ("direction", 15.012, 502.4, 17.021, 0.87225),
    ],
)
def test_each_slip_has_its_own_optimum(slip, optimum, random_walk, moved_goals, value):
    tables = FourRooms(slip=slip).make_tables()
    assert find_fewest_primitives(tables) @ tables.starts == pytest.approx(optimum, abs=5e-4)
    walk = make_model(count_primitives(tables), 1.0)
    assert evaluate(walk, make_uniform_policy(walk)) @ tables.starts == pytest.approx(random_walk, abs=0.05)
    assert find_values(make_model(tables, 0.99)) @ tables.starts == pytest.approx(value, abs=5e-6)
    starts = [cell for cell in range(len(GRID)) if cell != EAST_HALLWAY]
    moved = [FourRooms(goal, slip, starts).make_tables() for goal in SOUTH_EAST_GOALS]
    steps = [find_fewest_primitives(tables) @ tables.starts for tables in moved]
    assert np.mean(steps) == pytest.approx(moved_goals, abs=5e-4)


def move_as_told(cell, direction, slip, rng):
    """One move, told as a story rather than as a distribution."""
    slips = rng.random() < 1 / 3
    if slip == "direction":
        others = [other for other in range(4) if other != direction]
        return GRID.move(cell, rng.choice(others) if slips else direction)
    if slip == "neighbour":
        return rng.choice(GRID.list_neighbours(cell)) if slips else GRID.move(cell, direction)
    there = GRID.move(cell, direction)
    moved_on = slip == "extra" and there != cell and slips
    return rng.choice(GRID.list_neighbours(there)) if moved_on else there


@pytest.mark.nightly
@pytest.mark.parametrize("slip", SLIPS)
def test_slips_are_as_told(slip):
    rng = np.random.default_rng(0)
    tables = FourRooms(None, slip).make_tables()
    for cell in (0, 24, 25, 30, 62, 103):
        for direction in range(4):
            counts = np.bincount([move_as_told(cell, direction, slip, rng) for _ in range(1_500)], minlength=104)
            possible = tables.probability[cell, direction] > 0
            assert counts[~possible].sum() == 0
            if possible.sum() > 1:
                expected = tables.probability[cell, direction, possible] * 1_500
                assert chisquare(counts[possible], expected).pvalue > 1e-5


def test_passing_the_goal_in_a_slip_is_not_arriving():
    """The published program asks for the goal after the slip."""
    tables = FourRooms(slip="extra").make_tables()
    above = GRID.numbers[6, 9]
    assert tables.ending[above, 1].sum() == pytest.approx(2 / 3)


# --- hallway options -------------------------------------------------------------------


@pytest.mark.parametrize("slip", SLIPS)
def test_each_room_has_an_option_to_each_of_its_hallways(slip):
    options = make_hallway_options(slip)
    assert len(options) == 8
    for option, (room, hallways) in zip(options, ((room, ROOMS[room][2]) for room in ROOMS for _ in "ab"), strict=True):
        inside = make_room_mask(room)
        assert (option.initiation[inside]).all() and option.initiation.sum() == inside.sum() + 1
        assert option.initiation[list(hallways)].sum() == 1
        np.testing.assert_array_equal(option.termination, ~option.initiation)


@pytest.mark.nightly
def test_without_slip_hallway_options_take_shortest_paths():
    distances = compute_distances()
    for option in make_hallway_options("none"):
        (target,) = (h for h in HALLWAYS if option.name.endswith(str(GRID.cells[h])))
        for start in np.flatnonzero(option.initiation):
            env = FourRooms(None, "none")
            env.reset(seed=0)
            env.set_state(State(int(start)))
            while not option.termination[env.state.number]:
                env.step(int(option.policy[env.state.number].argmax()))
            assert env.state == State(target, distances[start, target])


@pytest.mark.parametrize("slip", SLIPS)
def test_planning_over_options_reaches_the_rooms_of_the_goal_in_one_sweep_and_all_in_two(slip):
    tables = FourRooms(slip=slip).make_tables()
    model = make_option_model(tables, make_hallway_options(slip), GAMMA)
    near = make_room_mask("north-east") | make_room_mask("south-east")
    near[[NORTH_HALLWAY, SOUTH_HALLWAY]] = True
    np.testing.assert_array_equal(find_values(model, sweeps=1) > 0, near)
    assert (find_values(model, sweeps=2) > 0).sum() == 103  # all but the goal, which is the end


def test_primitives_reach_one_step_farther_in_each_sweep():
    distances = compute_distances()[:, EAST_HALLWAY]
    model = make_model(FourRooms(slip="direction").make_tables(), GAMMA)
    for sweeps in (1, 2, 3):
        np.testing.assert_array_equal(find_values(model, sweeps) > 0, (distances > 0) & (distances <= sweeps))


def test_without_slip_two_sweeps_over_options_are_exact():
    tables = FourRooms(slip="none").make_tables()
    model = make_option_model(tables, make_hallway_options("none"), GAMMA)
    exact = np.where(np.arange(104) == EAST_HALLWAY, 0, GAMMA ** (compute_distances()[:, EAST_HALLWAY] - 1.0))
    near = find_values(model, sweeps=1) > 0
    np.testing.assert_allclose(find_values(model, sweeps=1)[near], exact[near], atol=1e-12)
    for sweeps in (2, 3):
        np.testing.assert_allclose(find_values(model, sweeps=sweeps), exact, atol=1e-12)


def test_sweeps_over_options_rise_to_what_options_can_do_and_both_together_to_the_optimum():
    """The slip of 1999: options alone lose a little even to a hallway, much to a goal inside a room."""
    for goal, lost in ((EAST_HALLWAY, 1e-3), (GRID.numbers[9, 9], 0.5)):
        tables = FourRooms(goal).make_tables()
        options = make_hallway_options()
        flat = find_values(make_model(tables, GAMMA))
        hallways = make_option_model(tables, options, GAMMA)
        both = make_option_model(tables, [*options, *make_primitive_options(104, 4)], GAMMA)
        sweeps = [find_values(hallways, sweeps) for sweeps in (1, 2, 3)] + [find_values(hallways)]
        assert all((later >= earlier - 1e-12).all() for earlier, later in zip(sweeps, sweeps[1:], strict=False))
        price = 1 - (sweeps[-1] @ tables.starts) / (flat @ tables.starts)
        assert 0.1 * lost < price < 2 * lost
        np.testing.assert_allclose(find_values(both), flat, atol=1e-9)
        assert (find_values(both, 2) >= find_values(make_model(tables, GAMMA), 2) - 1e-12).all()
