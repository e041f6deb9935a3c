"""Collision shapes for coal, from URDF elements: primitives, and convex hulls or surfaces of meshes.

Convex hulls are faster to test than meshes, and larger, so that no collision is missed. They are cached on disk, by the
content of the mesh file.
"""

# pyright: reportAttributeAccessIssue=false
# (coal is compiled and carries no types)

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env import mesh_files
from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.urdf import LARGEST_VISUAL, read_numbers
from hrl_escape.errors import FileReadError, FileWriteError, RobotError
from hrl_escape.files import read_bytes, write_bytes
from hrl_escape.kernels import hash_code, make_cache_folder

THINNEST = 1e-4
"""A mesh that is thinner than this in some direction is thickened to ten times as much, m."""
_SOURCES = (Path(__file__), Path(mesh_files.__file__))  # what cached hulls depend on
_DIRECTIONS = 128  # half-spaces that enclose a hull which coal refuses


def make_shape(geometry: ElementTree.Element, link: str) -> Any:
    """Return the shape of a `<geometry>` element, a mesh as its hull; `link` is for messages.

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
        status = os.stat(path)
        return _load_hull(path, read_numbers(shape.get("scale", "1 1 1"), 3) or (), status.st_mtime_ns, status.st_size)
    except (FileReadError, OSError) as error:
        raise RobotError(f"the collision mesh of link {link!r}: {error}") from None


def make_surface(path: str, scale: tuple[float, ...]) -> Any:
    """Return the triangles of a mesh as a tree of boxes, its coordinates times `scale` (3,); errors as of `load_mesh`.

    The surface may be concave and open. It meets only what crosses it.
    """
    load_mesh(path)
    status = os.stat(path)
    return _load_surface(path, scale, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _load_surface(path: str, scale: tuple[float, ...], _time: int, _size: int) -> Any:
    """Build the surface of a mesh, once while the file does not change."""
    mesh, tree = load_mesh(path), coal.BVHModelOBBRSS()
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in mesh.vertices * np.array(scale):
        corners.append(vertex)
    for triangle in mesh.triangles.tolist():
        faces.append(coal.Triangle(*triangle))
    tree.beginModel(len(faces), len(corners))
    tree.addSubModel(corners, faces)
    tree.endModel()
    return tree


@lru_cache(maxsize=512)
def _load_hull(path: str, scale: tuple[float, ...], _time: int, _size: int) -> Any:
    """Return the hull of a mesh, from the cache on disk if it is there; once while the file does not change."""
    content = read_bytes(path, "mesh", LARGEST_VISUAL)
    key = hashlib.sha256(f"{Path(path).suffix.lower()} {scale} ".encode() + content).hexdigest()
    file = make_cache_folder(f"hulls-{_hash_code()}") / key
    corners = _read_corners(file)
    if corners is None:
        corners = np.array(make_hull(load_mesh(path).vertices * np.array(scale)).points())
        with suppress(FileWriteError):
            _write_corners(file, corners)
    return _make_convex(corners)  # also of new corners, so that a hull is the same before and after it is on disk


@cache
def _hash_code() -> str:
    """Return the digest of the code that cached hulls depend on."""
    return hash_code(_SOURCES)


def _read_corners(file: Path) -> NDArray[np.float64] | None:
    """Return the corners of a cached hull, or None if there are none or the file is damaged."""
    try:
        content = read_bytes(file, "hull")
    except FileReadError:
        return None
    digest, numbers = content[:32], content[32:]
    if hashlib.sha256(numbers).digest() != digest:
        return None
    return np.frombuffer(numbers, dtype="<f8").reshape(-1, 3)


def _write_corners(file: Path, corners: NDArray[np.float64]) -> None:
    numbers = np.ascontiguousarray(corners, dtype="<f8").tobytes()
    write_bytes(file, hashlib.sha256(numbers).digest() + numbers)


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
