"""Meshes from files (STL, OBJ, DAE and what else assimp reads) as triangles, by coal."""

# pyright: reportAttributeAccessIssue=false
# (the library is compiled and carries no types)

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import FileReadError, MissingPackageError

try:
    import coal
except ImportError as missing:
    raise MissingPackageError("pin", "Reading a mesh", missing) from missing


def load_triangles(path: str | Path) -> NDArray[np.float64]:
    """Corners of a mesh's triangles, shape (triangles, 3, 3), in the file's own frame and unit.

    Raises:
        FileReadError: there is no such file, or it is no mesh.
    """
    try:
        mesh = coal.MeshLoader().load(str(Path(path).resolve(strict=True)))
    except (OSError, RuntimeError, ValueError) as error:
        raise FileReadError(f"{path} is no mesh that assimp reads: {type(error).__name__}") from None
    corners = [[triangle[corner] for corner in range(3)] for triangle in map(mesh.tri_indices, range(mesh.num_tris))]
    return np.asarray(mesh.vertices(), dtype=np.float64)[np.array(corners, dtype=np.int64).reshape(-1, 3)]
