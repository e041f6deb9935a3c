"""A rectangular base among boxes and cylinders, against coal, which knows nothing of its closed forms."""

from __future__ import annotations

import math

import coal
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import optimize

from hrl_escape.env.bases import Disc, RectangularBase
from hrl_escape.env.bases.rectangle import (
    TensorRectangle,
    compute_base_contact,
    compute_base_distance,
    is_turn_blocked,
    measure_base_gap,
)
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.tensor_geometry import Shapes, stack_shapes

SIZE = (0.6, 0.3)
CLOSE = 1e-4  # m, within which coal and a closed form may decide differently

places = st.floats(-1.5, 1.5)
angles = st.floats(-math.pi, math.pi)
lengths = st.floats(0.05, 0.8)
boxes = st.builds(lambda a, b, yaw: make_footprint(0.0, 0.0, a, b, yaw), lengths, lengths, angles)
discs = st.builds(lambda a: make_footprint(0.0, 0.0, a, a, 0.0, True), lengths)
shapes = st.one_of(boxes, discs)
gaps = st.floats(2 * CLOSE, 1.0)


def measure(x: float, y: float, heading: float, shape: Footprint) -> float:
    """Distance by coal of the rectangle to a shape, m; negative or 0 where they overlap."""
    base = coal.Box(2 * SIZE[0], 2 * SIZE[1], 10.0)
    other = coal.Cylinder(shape.half_x, 10.0) if shape.is_disc else coal.Box(2 * shape.half_x, 2 * shape.half_y, 10.0)
    placed = []
    for px, py, turn in ((x, y, heading), (shape.x, shape.y, math.atan2(shape.sin, shape.cos))):
        rotation = np.array([(math.cos(turn), -math.sin(turn), 0.0), (math.sin(turn), math.cos(turn), 0.0), (0, 0, 1)])
        placed.append(coal.Transform3s(rotation, np.array([px, py, 0.0])))
    return coal.distance(base, placed[0], other, placed[1], coal.DistanceRequest(), coal.DistanceResult())


def place_apart(gap: float, bearing: float, heading: float, shape: Footprint) -> tuple[float, float]:
    """Place on a bearing from the middle of a shape at which coal finds the rectangle that gap away from it."""
    x, y = math.cos(bearing), math.sin(bearing)
    away: float = optimize.brentq(lambda away: measure(away * x, away * y, heading, shape) - gap, 0.0, 4.0)
    return away * x, away * y


def turned(heading: float) -> tuple[float, float]:
    return math.cos(heading), math.sin(heading)


def as_tensors(shape: Footprint) -> Shapes:
    return Shapes(*torch.tensor(stack_shapes([[shape]])))


def as_tensor_base(x: float, y: float, heading: float) -> TensorRectangle:
    return TensorRectangle(*(torch.tensor([value], dtype=torch.float64) for value in (x, y, *turned(heading))), SIZE)


@settings(max_examples=60, deadline=None)
@given(places, places, angles, shapes)
def test_gap_and_distance_are_those_of_coal(x, y, heading, shape):
    truth = measure(x, y, heading, shape)
    gap = measure_base_gap(x, y, *turned(heading), SIZE, shape)
    assert gap <= truth + CLOSE or gap <= CLOSE >= truth
    assert truth <= CLOSE or gap > 0.0
    distance = compute_base_distance(x, y, *turned(heading), SIZE, shape)
    assert abs(distance - max(truth, 0.0)) < CLOSE
    base = as_tensor_base(x, y, heading)
    assert abs(base.measure_gap(as_tensors(shape)).item() - gap) < 1e-12
    if not shape.is_disc:
        assert abs(base.compute_distance(as_tensors(shape)).item() - distance) < 1e-12


@settings(max_examples=60, deadline=None)
@given(gaps, angles, angles, angles, st.floats(0.1, 3.0), shapes)
def test_a_move_ends_at_the_first_contact(gap, bearing, heading, direction, length, shape):
    x, y = place_apart(gap, bearing, heading, shape)
    dx, dy = length * math.cos(direction), length * math.sin(direction)
    share = min(compute_base_contact(x, y, *turned(heading), SIZE, dx, dy, shape), 1.0)
    for at in np.linspace(0.0, share, 6).tolist():
        assert measure(x + at * dx, y + at * dy, heading, shape) > -CLOSE
    if share < 1.0:
        assert abs(measure(x + share * dx, y + share * dy, heading, shape)) < CLOSE
    dxs, dys = (torch.tensor([value], dtype=torch.float64) for value in (dx, dy))
    assert abs(as_tensor_base(x, y, heading).compute_first_contact(dxs, dys, as_tensors(shape)).item() - share) < 1e-9


@settings(max_examples=60, deadline=None)
@given(gaps, angles, angles, st.floats(0.02, 3.1), st.sampled_from((-1, 1)), shapes)
def test_a_turn_is_blocked_by_what_is_met_on_the_way(gap, bearing, heading, turn, sense, shape):
    (x, y), turn = place_apart(gap, bearing, heading, shape), sense * turn
    least = min(measure(x, y, heading + turn * share, shape) for share in np.linspace(0.0, 1.0, 48).tolist())
    assume(not -CLOSE < least < 0.025)  # between two headings that are tried it may come nearer by that
    is_blocked = is_turn_blocked(x, y, *turned(heading), *turned(heading + turn), turn, SIZE, shape)
    assert is_blocked == (least <= 0.0)
    to_cos, to_sin, angle = (torch.tensor([value], dtype=torch.float64) for value in (*turned(heading + turn), turn))
    assert as_tensor_base(x, y, heading).is_turn_blocked(to_cos, to_sin, angle, as_tensors(shape)).item() == is_blocked


@pytest.mark.parametrize("turn", [math.radians(10), -math.radians(10), math.radians(90)])
def test_a_thin_post_that_only_a_corner_meets_on_the_way_blocks_the_turn(turn):
    """Clear of the base before and afterwards, and between two sampled headings."""
    corner = math.atan2(SIZE[1], SIZE[0]) + (0.5 * turn if abs(turn) < 1 else 0.1)
    away = math.hypot(*SIZE) - 1e-5
    post = make_footprint(away * math.cos(corner), away * math.sin(corner), 1e-6, 1e-6, 0.0, True)
    assert measure_base_gap(0, 0, 1, 0, SIZE, post) > 0 < measure_base_gap(0, 0, *turned(turn), SIZE, post)
    assert is_turn_blocked(0, 0, 1, 0, *turned(turn), turn, SIZE, post)
    beyond = post._replace(x=post.x * 1.001, y=post.y * 1.001)
    assert not is_turn_blocked(0, 0, 1, 0, *turned(turn), turn, SIZE, beyond)


def test_a_base_at_a_wall_slides_along_it_and_leaves_it_but_goes_no_further():
    wall = make_footprint(0.0, 1.0, 5.0, 0.1)
    y = 0.9 - SIZE[1]
    for rounding in (-1e-16, 0.0, 1e-16):
        at = (0.2, y + rounding, 1.0, 0.0, SIZE)
        assert compute_base_contact(*at, 0.3, 1e-6, wall) == 0.0
        for dx, dy in ((0.5, 0.0), (-0.5, 0.0), (0.3, -0.3), (0.0, -1.0)):
            assert compute_base_contact(*at, dx, dy, wall) == math.inf


def test_a_side_that_only_grazes_a_corner_is_no_contact():
    box = make_footprint(0.0, 0.0, 0.5, 0.5)
    for rounding in (-1e-16, 0.0, 1e-16):
        y = 0.5 + SIZE[1] + rounding
        assert compute_base_contact(-2.0, y, 1.0, 0.0, SIZE, 4.0, 0.0, box) == math.inf
    assert compute_base_contact(-2.0, y - 1e-6, 1.0, 0.0, SIZE, 4.0, 0.0, box) == pytest.approx(0.9 / 4.0)


def test_a_disc_has_no_corners_and_a_rectangle_those_of_its_settings():
    assert RobotConfig().base == Disc((0.75,)) and not RobotConfig().base.corners
    robot = RobotConfig(footprint="rectangle", body_length=1.2, body_width=0.6)
    assert robot.base == RectangularBase(SIZE)
    assert robot.base.corners == ((-0.6, -0.3), (0.6, -0.3), (0.6, 0.3), (-0.6, 0.3))
    assert robot.base.grow(0.1).size == pytest.approx((0.7, 0.4))
    assert (robot.inner_radius, robot.outer_radius) == (0.3, math.hypot(0.6, 0.3))
