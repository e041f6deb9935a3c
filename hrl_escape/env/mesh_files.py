"""Meshes from files (STL, OBJ or DAE), read strictly once for every engine.

Numbers are taken as they stand: a unit or an up axis that a DAE file names is not applied.
"""

# pyright: reportAttributeAccessIssue=false
# (the library is compiled and carries no types)

from __future__ import annotations

import os
import re
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.urdf import LARGEST_VISUAL, MESH_ENDINGS
from hrl_escape.errors import FileReadError, FileWriteError, MissingPackageError
from hrl_escape.files import check_files, read_bytes, temporary_folder

MOST_WORDS = 8_000_000
"""Words of the largest OBJ file, four for a vertex or a triangle; two million vertices take 5 s and 700 MB."""
_SPACE = bytes(number for number in range(256) if chr(number).isspace())


class TriangleMesh(NamedTuple):
    """Triangles of a mesh in the file's own frame and unit. Do not write to the arrays."""

    vertices: NDArray[np.float64]  # (n, 3)
    triangles: NDArray[np.int64]  # (m, 3), numbers of vertices


def load_mesh(path: str | Path) -> TriangleMesh:
    """Read a mesh, once while its file does not change.

    Raises:
        FileReadError: there is no such file, it is no plain file of a known kind, too large or no mesh, or a vertex is
            not finite.
        MissingPackageError: coal, which reads it, is not installed.
    """
    if os.path.exists(path):
        check_files([str(path)], "mesh", MESH_ENDINGS, LARGEST_VISUAL)
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        raise FileReadError(f"{path}: no such mesh") from None
    return _load(os.path.realpath(path), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=256)
def _load(path: str, _time: int, _size: int) -> TriangleMesh:
    vertices, triangles = _read_obj(path) if path.lower().endswith(".obj") else _read_by_assimp(path)
    if not np.isfinite(vertices).all():
        raise FileReadError(f"{path} is no mesh to plan in: a vertex is not a finite number")
    if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
        raise FileReadError(f"{path} is no mesh: it has {len(triangles)} triangles among {len(vertices)} vertices, or "
                            "one that refers to a vertex that is not there")
    return TriangleMesh(vertices, triangles)


def _read_by_assimp(path: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    try:
        import coal  # loads slowly
    except ImportError as missing:
        raise MissingPackageError("pin", "Reading a mesh", missing) from missing
    try:
        with temporary_folder() as folder:  # where a file that the mesh names is not found
            copy = folder / f"mesh{Path(path).suffix.lower()}"
            copy.write_bytes(read_bytes(path, "mesh", LARGEST_VISUAL))
            mesh = coal.MeshLoader().load(str(copy))
    except FileWriteError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        cause = re.search(r"Could not load resource .*\n(.*)", str(error))
        raise FileReadError(f"{path} is no mesh that assimp reads: {cause[1] if cause else type(error).__name__}"
                            ) from None
    vertices = np.asarray(mesh.vertices(), dtype=np.float64).reshape(-1, 3)
    corners = [[triangle[corner] for corner in range(3)] for triangle in map(mesh.tri_indices, range(mesh.num_tris))]
    return vertices, np.array(corners, dtype=np.int64).reshape(-1, 3)


def _read_obj(path: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read vertices and faces of a Wavefront OBJ file.

    Polygons become fans of triangles; those without three different corners are left out. Assimp refuses numbers such
    as `.3`, and drops faces that refer to no vertex.
    """
    vertices, triangles = list[list[float]](), list[tuple[int, int, int]]()
    content = read_bytes(path, "mesh", LARGEST_VISUAL)
    words = len(content) - len(content.translate(None, _SPACE))
    if words > MOST_WORDS:
        raise FileReadError(f"{path}: this mesh has some {words:,} words; at most {MOST_WORDS:,} are read. Simplify it")
    text = content.decode("latin-1").replace("\\\n", " ").replace("\\\r\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        word, *rest = line.split("#")[0].split() or [""]
        try:
            if word == "v":
                vertices.append([float(value) for value in rest[:3]])
                if len(rest) < 3:
                    raise ValueError
            elif word == "f":
                face = [int(corner.split("/")[0]) for corner in rest]
                face = [corner - 1 if corner > 0 else len(vertices) + corner for corner in face]
                if len(face) < 3 or min(face) < 0:
                    raise ValueError
                fan = ((face[0], face[k], face[k + 1]) for k in range(1, len(face) - 1))
                triangles += [corners for corners in fan if len({*corners}) == 3]
        except ValueError:
            raise FileReadError(f"{path} is no OBJ mesh: line {number} is {line[:80]!r}") from None
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def load_triangles(path: str | Path) -> NDArray[np.float64]:
    """Return the corners of a mesh's triangles, shape (triangles, 3, 3); errors as of `load_mesh`."""
    mesh = load_mesh(path)
    return mesh.vertices[mesh.triangles]


def format_triangles(mesh: TriangleMesh) -> str:
    """Return the mesh as a Wavefront OBJ file, with flat normals."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.tile((0.0, 0.0, 1.0), (len(normals), 1)), where=length > 0.0)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals.tolist()]
    lines += [f"f {a}//{n} {b}//{n} {c}//{n}" for n, (a, b, c) in enumerate((mesh.triangles + 1).tolist(), 1)]
    return "\n".join(lines) + "\n"


def write_meshes(root: ElementTree.Element, folder: Path) -> None:
    """Write the meshes of a URDF into a folder as OBJ files, and let the URDF refer to those, in place.

    Bullet ends the process on some damaged files, and applies a DAE file's unit and up axis, which others do not.
    """
    for number, mesh in enumerate(root.iterfind("link//geometry/mesh")):
        path = folder / f"mesh-{number}.obj"
        path.write_text(format_triangles(load_mesh(mesh.get("filename", ""))))
        mesh.set("filename", str(path))
