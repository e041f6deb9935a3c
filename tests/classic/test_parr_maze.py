"""Parr's maze: hallways, pockets, and the price of going hallway by hallway."""

from __future__ import annotations

import numpy as np
import pytest

from tests.classic.exact import (
    evaluate,
    find_greedy_policy,
    find_values,
    make_model,
    make_option_model,
    make_policy_matrix,
    make_primitive_options,
)
from tests.classic.parr_maze import ParrMaze, draw_maze
from tests.classic.tabular import State


@pytest.fixture(scope="module")
def maze():
    return ParrMaze(3)


def count_open_sides(maze, cell):
    return len(maze.grid.list_neighbours(cell))


@pytest.mark.parametrize("blocks", [2, 3, 4])
def test_the_size_of_the_maze(blocks):
    assert len(draw_maze(blocks)) == 9 * blocks**2 + 18 * 2 * blocks * (blocks - 1)


def test_every_hallway_has_one_pocket(maze):
    pockets = [cell for cell in range(len(maze.grid)) if count_open_sides(maze, cell) == 1]
    assert len(pockets) == 12
    assert all(maze.find_intersection(cell) is None for cell in pockets)


def test_every_cell_can_be_reached(maze):
    seen, front = {maze.start}, [maze.start]
    for cell in front:
        new = [there for there in maze.grid.list_neighbours(cell) if there not in seen]
        seen.update(new)
        front.extend(new)
    assert len(seen) == len(maze.grid)


def test_intersections_are_numbered_row_by_row(maze):
    places = [maze.find_intersection(cell) for cell in range(len(maze.grid))]
    assert [places.count(number) for number in range(9)] == [9] * 9
    assert maze.find_intersection(maze.start) == 0
    assert [maze.find_next(4, direction) for direction in range(4)] == [1, 7, 3, 5]
    assert [maze.find_next(0, direction) for direction in range(4)] == [None, 3, None, 1]


def test_hallway_options_come_to_their_intersection(maze):
    """Without noise for sure; the option leaves its hallway nowhere else."""
    quiet = ParrMaze(3, noise=0.0)
    quiet.reset(seed=0)
    places = np.array([quiet.find_intersection(cell) for cell in range(len(quiet.grid))], object)
    options = quiet.make_hallway_options()
    assert len(options) == 24
    for option in options:
        source, target = map(int, option.name.split(" to "))
        if source == quiet.goal:
            continue  # the episode is over there
        assert option.initiation[places == source].all()
        for start in np.flatnonzero(option.initiation):
            quiet.set_state(State(int(start)))
            while not option.termination[quiet.state.number]:
                quiet.step(int(option.policy[quiet.state.number].argmax()))
            assert quiet.find_intersection(quiet.state.number) == target


@pytest.mark.nightly
def test_going_hallway_by_hallway_costs_a_few_steps(maze):
    tables = maze.make_tables()
    options = maze.make_hallway_options()
    flat = find_values(make_model(tables, 1.0))
    hallways = find_values(make_option_model(tables, options, 1.0))
    both = make_option_model(tables, [*options, *make_primitive_options(len(maze.grid), 4)], 1.0)
    assert (hallways <= flat + 1e-8).all()
    assert 0.02 < 1 - flat[maze.start] / hallways[maze.start] < 0.10
    np.testing.assert_allclose(find_values(both), flat, atol=1e-8)


def test_the_optimal_policy_earns_its_value_when_run(maze):
    model = make_model(maze.make_tables(), 1.0)
    values = find_values(model)
    policy = find_greedy_policy(model, values)
    np.testing.assert_allclose(evaluate(model, make_policy_matrix(policy, 4)), values, atol=1e-8)
    maze.reset(seed=0)
    returns = []
    for _ in range(1_000):
        state, total, over = maze.reset()[0], 0.0, False
        while not over:
            state, reward, over, _, _ = maze.step(int(policy[state]))
            total += reward
        returns.append(total)
    assert np.mean(returns) == pytest.approx(values[maze.start], abs=4 * np.std(returns) / np.sqrt(1_000))
