"""Collision shapes of links for coal, from URDF elements: primitives, and convex hulls of meshes.

Convex hulls are faster to test than meshes, and larger, so that no collision is missed.
"""

# pyright: reportAttributeAccessIssue=false
# (coal is compiled and carries no types)

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.urdf import read_numbers
from hrl_escape.errors import FileReadError, RobotError

THINNEST = 1e-4
"""A mesh that is thinner than this in some direction is thickened to ten times as much, m."""
_DIRECTIONS = 128  # half-spaces that enclose a hull which coal refuses


def make_shape(geometry: ElementTree.Element, link: str) -> Any:
    """Return the shape of a `<geometry>` element; `link` is for messages.

    Raises:
        RobotError: the mesh cannot be read.
    """
    shape = geometry[0]
    if shape.tag == "box":
        return coal.Box(*_read(shape, "size", 3))
    if shape.tag == "cylinder":
        return coal.Cylinder(*_read(shape, "radius", 1), *_read(shape, "length", 1))
    if shape.tag == "sphere":
        return coal.Sphere(*_read(shape, "radius", 1))
    path = shape.get("filename", "")
    try:
        vertices = load_mesh(path).vertices
    except FileReadError as error:
        raise RobotError(f"the collision mesh of link {link!r}: {error}") from None
    return make_hull(vertices * np.array(read_numbers(shape.get("scale", "1 1 1"), 3)))


def make_hull(points: NDArray[np.float64]) -> Any:
    """Return a convex shape around points (n, 3), m; flat and thin ones are thickened."""
    points = _thicken(np.unique(points, axis=0))
    try:
        return _make_convex(points)
    except RuntimeError:  # coal takes at most 255 neighbours of a corner
        return _make_convex(_enclose(points))


def _make_convex(points: NDArray[np.float64]) -> Any:
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    return coal.ConvexBase.convexHull(corners, True, "Qt")


def _thicken(points: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred[np.linspace(0, len(points) - 1, min(len(points), 2000)).astype(int)])
    for axis in axes:
        if np.ptp(centred @ axis) < THINNEST:
            points = np.concatenate([points - 5 * THINNEST * axis, points + 5 * THINNEST * axis])
    return points


def _enclose(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of a polytope of few faces that holds the points."""
    from scipy.spatial import HalfspaceIntersection  # loads slowly

    turns = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci lattice on the sphere
    z, angle = 1.0 - 2.0 * turns / _DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * turns
    flat = np.sqrt(1.0 - z * z)
    directions = np.concatenate([np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1),
                                 np.eye(3), -np.eye(3)])
    far = (points @ directions.T).max(axis=0)
    return HalfspaceIntersection(np.column_stack([directions, -far]), points.mean(axis=0)).intersections


def _read(shape: ElementTree.Element, key: str, count: int) -> tuple[float, ...]:
    numbers = read_numbers(shape.get(key, ""), count)
    assert numbers is not None, "checked when the robot was made"
    return numbers
