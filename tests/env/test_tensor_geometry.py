"""Tensor geometry against the scalar one: distances, first contact and rays, shape by shape."""

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from hrl_escape.env import geometry
from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.sight import Scanner
from hrl_escape.env.tensor_geometry import Shapes, cast_rays, compute_distance, compute_first_contact, stack_shapes

numbers = st.floats(-8, 8)
sizes = st.floats(0.05, 4)
yaws = st.one_of(st.sampled_from([0.0, math.pi / 2, math.pi]), st.floats(-4, 4))
outlines = st.builds(make_footprint, numbers, numbers, sizes, sizes, yaws, st.booleans())


def shapes_of(*rows: Footprint) -> Shapes:
    return Shapes(*torch.from_numpy(stack_shapes([rows])))


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def meet(x: float, y: float, dx: float, dy: float, radius: float, outline: Footprint, single: bool = False) -> float:
    shapes = shapes_of(outline)
    fraction = compute_first_contact(column(x), column(y), column(dx), column(dy), radius,
                                     shapes.split() if single else shapes)
    return max(fraction.item(), 0.0)


@given(st.lists(outlines, min_size=1, max_size=4), numbers, numbers)
def test_distances_are_those_of_the_scalar_geometry(some, x, y):
    found = compute_distance(column(x), column(y), shapes_of(*some))[:, 0]
    assert found.tolist() == [pytest.approx(geometry.compute_distance(x, y, one), abs=1e-12) for one in some]


@pytest.mark.nightly
@given(outlines, numbers, numbers, st.floats(0.05, 1.5), st.floats(0, math.tau), st.floats(0.01, 8))
def test_first_contact_is_that_of_the_scalar_geometry(outline, x, y, radius, direction, length):
    dx, dy = length * math.cos(direction), length * math.sin(direction)
    expected = min(1.0, geometry.compute_first_contact(x, y, dx, dy, radius, outline))

    def spread(step: float) -> float:
        moves = [(a * step, b * step, c * step) for a, b, c in (*np.eye(3), *-np.eye(3))]
        near = [min(1.0, geometry.compute_first_contact(x + a, y + b, dx - turn * dy, dy + turn * dx, radius, outline))
                for a, b, turn in moves]
        return max(near) - min(near)

    assume(spread(1e-6) < 1e-3)  # grazing: rounding decides
    assert abs(meet(x, y, dx, dy, radius, outline) - expected) < 1e-7
    if spread(1e-4) < 0.5:  # else rounding to single precision decides
        assert abs(meet(x, y, dx, dy, radius, outline, single=True) - expected) < 1e-3


@pytest.mark.nightly
@given(outlines, st.floats(0, math.tau), st.floats(0.05, 1.5), st.floats(0, math.tau), st.floats(0.1, 3))
def test_a_resting_disc_is_stopped_only_if_it_moves_inwards(outline, side, radius, direction, length):
    x, y = outline.x + 20 * math.cos(side), outline.y + 20 * math.sin(side)
    toward = (-20 * math.cos(side), -20 * math.sin(side))
    first = meet(x, y, *toward, radius, outline)
    x, y = x + first * toward[0], y + first * toward[1]
    dx, dy = length * math.cos(direction), length * math.sin(direction)
    ahead = geometry.compute_distance(x + 1e-4 * dx, y + 1e-4 * dy, outline) - geometry.compute_distance(x, y, outline)
    assume(abs(ahead) > 1e-6 * length)
    for single, most in ((False, 1e-9), (True, 2e-6)):
        found = meet(x, y, dx, dy, radius, outline, single)
        assert found * -ahead / 1e-4 < most if ahead < 0 else found == 1.0  # metres that it moves inwards


@pytest.mark.nightly
@given(st.floats(-10, 10), st.floats(0.3, 10), st.floats(0.05, 1.5), st.floats(0.1, 3))
def test_a_disc_passes_flush_under_the_end_of_a_wall(y, half, radius, length):
    wall = make_footprint(-2.56, y, half, 0.1, math.pi / 2)
    at = y - half - 5.0
    at += meet(-2.56, at, 0.0, 5.0, radius, wall) * 5.0
    for x in (-2.56 + 0.11 + radius, -2.56 + 0.11, -2.56):
        assert meet(x, at, -length, 0.0, radius, wall) == 1.0
        assert meet(x, at, -length, 0.0, radius, wall, single=True) == 1.0


def test_nothing_is_met_where_nothing_moves():
    box = make_footprint(0, 0, 1, 1)
    for x in (0.0, 0.5, 1.2, 5.0):
        assert meet(x, 0.3, 0.0, 0.0, 0.5, box) == 1.0


def test_shapes_that_fill_a_table_up_are_met_by_nothing():
    table = stack_shapes([[make_footprint(0, 0, 1, 1)], [make_footprint(3, 0, 1, 1), make_footprint(0, 3, 1, 1, 0.3)]])
    shapes = Shapes(*torch.from_numpy(table)[:, :, 0].unsqueeze(-1))  # the first room: one shape and a filler
    fractions = compute_first_contact(column(-5), column(0), column(10), column(0), 0.5, shapes.split())
    assert fractions[:, 0].tolist() == [pytest.approx(0.35, abs=1e-6), 1.0]


@pytest.mark.nightly
@given(st.lists(outlines, min_size=1, max_size=4), numbers, numbers)
def test_rays_are_those_of_the_scalar_geometry(some, x, y):
    assume(all(geometry.compute_distance(x, y, one) > 1e-3 for one in some))
    angles = np.linspace(0, math.tau, 16, endpoint=False) + 0.1
    expected, *beside = (np.minimum(Scanner(some, angles + turn).measure(x, y, 1.0, 0.0), 40.0)
                         for turn in (0.0, 1e-7, -1e-7))
    ray_x, ray_y = (torch.from_numpy(side(angles))[:, None, None] for side in (np.cos, np.sin))
    found = cast_rays(column(x), column(y), ray_x, ray_y, shapes_of(*some)).amin(1)[:, 0].clamp(0.0, 40.0).numpy()
    clear = np.ptp([expected, *beside], axis=0) < 1e-3  # rays that graze an outline may go either way
    assert np.abs(found - expected)[clear].max(initial=0.0) < 1e-9
