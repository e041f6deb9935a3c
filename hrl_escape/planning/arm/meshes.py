"""Meshes from files (STL, OBJ or DAE) as triangles, by coal.

Numbers are taken as they stand: a unit or an up axis that a DAE file names is not applied.
"""

# pyright: reportAttributeAccessIssue=false
# (the library is compiled and carries no types)

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.robot import LARGEST_MESHES, MESH_ENDINGS
from hrl_escape.errors import FileReadError, MissingPackageError
from hrl_escape.files import check_files

try:
    import coal
except ImportError as missing:
    raise MissingPackageError("pin", "Reading a mesh", missing) from missing


def load_triangles(path: str | Path) -> NDArray[np.float64]:
    """Corners of a mesh's triangles, shape (triangles, 3, 3), in the file's own frame and unit.

    Raises:
        FileReadError: there is no such file, it is no plain file of a known kind, too large or no mesh, or a vertex is
            no number.
    """
    if Path(path).exists():
        check_files([str(path)], "mesh", MESH_ENDINGS, LARGEST_MESHES)
    try:
        mesh = coal.MeshLoader().load(str(Path(path).resolve(strict=True)))
    except (OSError, RuntimeError, ValueError) as error:
        raise FileReadError(f"{path} is no mesh that assimp reads: {type(error).__name__}") from None
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise FileReadError(f"{path} is no mesh to plan in: a vertex is not a finite number")
    corners = [[triangle[corner] for corner in range(3)] for triangle in map(mesh.tri_indices, range(mesh.num_tris))]
    return vertices[np.array(corners, dtype=np.int64).reshape(-1, 3)]
