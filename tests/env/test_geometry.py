"""Planar geometry against independent references: dense sampling and shapely-free brute force."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from hrl_escape.env.geometry import (
    compute_distance,
    compute_distance_many,
    compute_first_contact,
    make_footprint,
    stack_footprints,
)

numbers = st.floats(-5, 5, allow_nan=False)
sizes = st.floats(0.05, 3)
shapes = st.builds(make_footprint, numbers, numbers, sizes, sizes, st.floats(-4, 4), st.booleans())


def sample_outline(shape, count=4000):
    """Points on the outline of a footprint, made without the code under test."""
    is_disc, x, y, cos, sin, half_x, half_y = shape
    t = np.linspace(0, 1, count // 4)
    if is_disc:
        angles = np.linspace(0, math.tau, count)
        return np.stack([x + half_x * np.cos(angles), y + half_x * np.sin(angles)], axis=1)
    across, up = half_x * (2 * t - 1), half_y * (2 * t - 1)
    own = np.concatenate([
        np.stack([across, np.full_like(t, half_y)], 1), np.stack([across, np.full_like(t, -half_y)], 1),
        np.stack([np.full_like(t, half_x), up], 1), np.stack([np.full_like(t, -half_x), up], 1),
    ])
    return own @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


def is_inside(shape, px, py):
    is_disc, x, y, cos, sin, half_x, half_y = shape
    dx, dy = px - x, py - y
    if is_disc:
        return math.hypot(dx, dy) <= half_x
    return abs(cos * dx + sin * dy) <= half_x and abs(cos * dy - sin * dx) <= half_y


@given(shapes, numbers, numbers)
def test_distance_is_that_to_the_nearest_outline_point(shape, px, py):
    found = compute_distance(px, py, shape)
    nearest = np.hypot(*(sample_outline(shape) - (px, py)).T).min()
    assert abs(found - (0.0 if is_inside(shape, px, py) else nearest)) < 0.01
    assert math.isclose(compute_distance_many(np.array([[px, py]]), stack_footprints([shape]))[0], found, abs_tol=1e-9)


@given(shapes, numbers, numbers, st.floats(-3, 3), st.floats(-3, 3), st.floats(0.05, 1.5))
def test_first_contact_is_where_dense_marching_first_comes_too_near(shape, px, py, dx, dy, radius):
    assume(compute_distance(px, py, shape) > radius + 1e-6 and math.hypot(dx, dy) > 1e-3)
    found = compute_first_contact(px, py, dx, dy, radius, shape)
    fractions = np.linspace(0, 1, 3001)
    path = np.stack([px + fractions * dx, py + fractions * dy], axis=1)
    distances = compute_distance_many(path, stack_footprints([shape]))
    before = distances[fractions <= min(found, 1.0)]
    assert before.min() >= radius - 1e-6  # never nearer on the way
    if found < 1.0:
        at = compute_distance(px + found * dx, py + found * dy, shape)
        assert abs(at - radius) < 1e-7  # stops exactly at the clearance
        after = distances[fractions > found]
        assert not len(after) or after.min() < radius + 1e-9  # and for a reason


@given(shapes, st.floats(0, math.tau), st.floats(0.05, 1.5), st.floats(0, math.tau), st.floats(0.1, 3))
def test_a_touching_disc_stops_only_when_it_moves_inwards(shape, side, radius, direction, length):
    x, y = shape.x + 20 * math.cos(side), shape.y + 20 * math.sin(side)
    toward = (-20 * math.cos(side), -20 * math.sin(side))
    first = compute_first_contact(x, y, *toward, radius, shape)
    x, y = x + first * toward[0], y + first * toward[1]  # resting against the shape
    dx, dy = length * math.cos(direction), length * math.sin(direction)
    ahead = compute_distance(x + 1e-4 * dx, y + 1e-4 * dy, shape) - compute_distance(x, y, shape)
    assume(abs(ahead) > 1e-7 * length)
    found = compute_first_contact(x, y, dx, dy, radius, shape)
    assert found < 1e-6 if ahead < 0 else found == math.inf


def test_sliding_along_a_wall_is_free_and_keeps_its_distance():
    wall = make_footprint(0, 10.1, 20, 0.1, math.pi)
    x, y = 0.0, 9.0
    y += compute_first_contact(x, y, 0, 3, 0.751, wall) * 3
    assert abs(y - 9.249) < 1e-12
    for _ in range(1000):
        assert compute_first_contact(x, y, 0.01, 0.0, 0.751, wall) == math.inf


@given(st.floats(-10, 10), st.floats(0.3, 10), st.floats(0.05, 1.5), st.floats(0.1, 3))
def test_a_disc_passes_flush_under_the_end_of_a_wall(y, half, radius, length):
    wall = make_footprint(-2.56, y, half, 0.1, math.pi / 2)
    at = y - half - 5.0
    at += compute_first_contact(-2.56, at, 0.0, 5.0, radius, wall) * 5.0  # as high as the wall's end allows
    for x in (-2.56 + 0.11 + radius, -2.56 + 0.11, -2.56):
        assert compute_first_contact(x, at, -length, 0.0, radius, wall) == math.inf


def test_a_long_step_does_not_tunnel():
    thin = make_footprint(0, 0, 0.001, 5)
    assert compute_first_contact(-1000, 0, 2000, 0, 0.1, thin) * 2000 - 1000 < 0
