"""Mesh files of a robot: of known kinds and bounded size, before any reader opens them.

Bullet and the viewer's reader take whatever a URDF names: a device, an archive that unpacks to
more than the memory, or millions of faces.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from hrl_escape.errors import FileReadError, RobotError
from hrl_escape.files import open_plain

__all__ = ["LARGEST_MESHES", "MESH_ENDINGS", "check_mesh_files"]

MESH_ENDINGS = (".stl", ".obj", ".dae")
LARGEST_MESHES = 2**25
"""Bytes of all mesh files of one robot, 32 MiB: some 600,000 faces."""


def check_mesh_files(urdf: ElementTree.Element) -> None:
    """Refuse a URDF whose mesh files are no plain files of a known kind, or too large.

    Raises:
        RobotError: the message names the file.
    """
    left = LARGEST_MESHES
    for name in sorted({mesh.get("filename", "") for mesh in urdf.iter("mesh")}):
        path = Path(name)
        if path.suffix.lower() not in MESH_ENDINGS:
            raise RobotError(f"the mesh {name[:200]!r} is of no known kind: {', '.join(MESH_ENDINGS)}")
        try:
            with open_plain(path, "mesh", largest=LARGEST_MESHES) as file:
                left -= file.seek(0, 2)
        except FileReadError as error:
            raise RobotError(str(error)) from None
        if left < 0:
            raise RobotError(f"{name}: the meshes of this robot have more than {LARGEST_MESHES:,} bytes together; "
                             "simplify them")
