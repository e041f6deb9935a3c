"""Macro-actions help or hurt by where the goal is: exact durations of random walks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.classic.empty_room import CENTRE, CORNER, EDGE, GRID, SIDE, EmptyRoom, make_macros
from tests.classic.exact import (
    count_primitives,
    evaluate,
    find_fewest_primitives,
    make_model,
    make_option_model,
    make_primitive_options,
    make_uniform_policy,
    model_option,
)


def walk_primitives(goal):
    tables = count_primitives(EmptyRoom(goal).make_tables())
    model = make_model(tables, 1.0)
    return evaluate(model, make_uniform_policy(model)) @ tables.starts


def walk_with_macros(goal, past):
    """Primitives and macros, equally likely; `past`: a macro does not stop at the goal, which ends only decisions."""
    options = [*make_primitive_options(len(GRID), 4), *make_macros()]
    stopping = EmptyRoom(goal).make_tables()
    model = make_option_model(count_primitives(EmptyRoom(None if past else goal).make_tables()), options, 1.0)
    if past:
        model = replace(model, follow=model.follow * (np.arange(len(GRID)) != goal))
    return evaluate(model, make_uniform_policy(model)) @ stopping.starts


@pytest.mark.parametrize(
    "goal, primitives, stopping, past",
    [
        (CENTRE, 209.94, 15_030.5, 3_317_424),
        (EDGE, 378.82, 82.98, 13_092.0),
        (CORNER, 657.09, 54.76, 54.76),
    ],
    ids=["centre", "edge", "corner"],
)
def test_durations_of_random_walks(goal, primitives, stopping, past):
    assert walk_primitives(goal) == pytest.approx(primitives, rel=1e-4)
    assert walk_with_macros(goal, past=False) == pytest.approx(stopping, rel=1e-4)
    assert walk_with_macros(goal, past=True) == pytest.approx(past, rel=1e-4)


def test_macros_hurt_at_the_centre_and_help_at_the_walls():
    factors = [walk_with_macros(goal, past=False) / walk_primitives(goal) for goal in (CENTRE, EDGE, CORNER)]
    assert factors[0] > 50 and factors[1] < 0.25 and factors[2] < 0.1


def test_episodes_that_end_inside_a_macro_are_worth_two_orders_of_magnitude():
    for goal in (CENTRE, EDGE):
        assert walk_with_macros(goal, past=True) > 100 * walk_with_macros(goal, past=False)
    assert walk_with_macros(CORNER, past=True) == pytest.approx(walk_with_macros(CORNER, past=False))


@pytest.mark.nightly
@pytest.mark.parametrize("goal", [EDGE, CORNER])
def test_a_run_of_the_walk_lasts_as_long_as_computed(goal):
    rng = np.random.default_rng(0)
    env = EmptyRoom(goal, horizon=None)
    env.reset(seed=0)
    durations = []
    for _ in range(1_500):
        state, over = env.reset()[0], False
        while not over:
            direction, runs = int(rng.integers(4)), rng.random() < 0.5
            while not over:
                state, _, over, _, _ = env.step(direction)
                if not runs or GRID.move(state, direction) == state:
                    break
        durations.append(env.get_state().elapsed)
    expected = walk_with_macros(goal, past=False)
    assert np.mean(durations) == pytest.approx(expected, abs=4 * np.std(durations) / np.sqrt(1_500))


def test_a_macro_lasts_to_its_wall_and_one_move_beside_it():
    tables = count_primitives(EmptyRoom(None).make_tables())
    north, south, west, east = (model_option(tables, macro, 1.0)[0] for macro in make_macros())
    rows, columns = (np.array(places) for places in zip(*GRID.cells, strict=True))
    np.testing.assert_allclose(north, np.maximum(rows, 1))
    np.testing.assert_allclose(south, np.maximum(SIDE - 1 - rows, 1))
    np.testing.assert_allclose(west, np.maximum(columns, 1))
    np.testing.assert_allclose(east, np.maximum(SIDE - 1 - columns, 1))


def test_the_optimum_is_the_distance():
    steps = find_fewest_primitives(EmptyRoom(CENTRE).make_tables())
    np.testing.assert_allclose(steps, [abs(row - 5) + abs(column - 5) for row, column in GRID.cells])
