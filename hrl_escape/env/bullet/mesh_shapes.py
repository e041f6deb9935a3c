"""Visual shapes from meshes, made without a memory leak.

pybullet never drops its references to the lists that `createVisualShape` reads: the outer lists and
each vertex. Every shape is therefore read from the same lists, filled anew.
"""

from __future__ import annotations

import threading
from typing import Any

import pybullet
from numpy.typing import NDArray

from hrl_escape.env.drawing.meshes import Mesh

__all__ = ["create_mesh_shape"]


class _Rows:
    """A list of [x, y, z] that reuses the same list objects for every mesh."""

    def __init__(self) -> None:
        self._made: list[list[float]] = []
        self._shown: list[list[float]] = []

    def fill(self, rows: NDArray[Any]) -> list[list[float]]:
        """The rows, in lists that the next call fills again."""
        self._made.extend([0.0, 0.0, 0.0] for _ in range(len(rows) - len(self._made)))
        for made, row in zip(self._made, rows.tolist(), strict=False):
            made[:] = row
        self._shown[:] = self._made[: len(rows)]
        return self._shown


_LOCK = threading.Lock()
_VERTICES, _NORMALS = _Rows(), _Rows()
_INDICES: list[int] = []


def create_mesh_shape(client: int, mesh: Mesh, colour: tuple[float, ...]) -> int:
    """Make a matt visual shape in a physics client; returns its number.

    Args:
        client: pybullet's number of the physics client.
        mesh: the triangles.
        colour: red, green, blue and opacity, 0 to 1.
    """
    with _LOCK:
        _INDICES[:] = mesh.triangles.ravel().tolist()
        return pybullet.createVisualShape(
            pybullet.GEOM_MESH, vertices=_VERTICES.fill(mesh.vertices), normals=_NORMALS.fill(mesh.normals),
            indices=_INDICES, rgbaColor=colour, specularColor=(0, 0, 0), physicsClientId=client,
        )
