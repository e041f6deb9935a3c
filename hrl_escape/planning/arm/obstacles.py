"""`Obstacle`: a box, cylinder, sphere or mesh at any placement, for an arm to avoid or to hold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.placements import read_placement
from hrl_escape.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class Obstacle:
    """A named shape in the world. Make one with `box`, `cylinder`, `sphere` or `mesh`.

    A placement is a position (3,), m; position, roll, pitch and yaw (6,), m and rad; or a matrix (4, 4).

    Attributes:
        name: its name.
        shape: kind of shape.
        sizes: sides of a box, radius and length of a cylinder, radius of a sphere, scales of a mesh.
        pose: rows of its placement in the world, 16 numbers.
        file: path of its mesh; empty for other shapes.
    """

    name: str
    shape: Literal["box", "cylinder", "sphere", "mesh"]
    sizes: tuple[float, ...]
    pose: tuple[float, ...]
    file: str = ""

    @classmethod
    def box(cls, name: str, size: Sequence[float], placement: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Make a box.

        Args:
            name: its name.
            size: its sides along its own x, y and z, m.
            placement: of its centre in the world.

        Raises:
            ConfigError: a size or the placement is none.
        """
        return cls._make(name, "box", _read_sizes(name, size, 3), placement)

    @classmethod
    def cylinder(cls, name: str, radius: float, length: float, placement: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Make a cylinder along its own z; arguments in m, errors as of `box`."""
        return cls._make(name, "cylinder", _read_sizes(name, (radius, length), 2), placement)

    @classmethod
    def sphere(cls, name: str, radius: float, placement: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Make a sphere; arguments in m, errors as of `box`."""
        return cls._make(name, "sphere", _read_sizes(name, (radius,), 1), placement)

    @classmethod
    def mesh(cls, name: str, path: str | Path, placement: ArrayLike = (0.0, 0.0, 0.0), *, scale: float = 1.0) -> Self:
        """Make an obstacle of the surface of a mesh, which may be concave.

        Args:
            name: its name.
            path: STL, OBJ or DAE file.
            placement: of the mesh's origin in the world.
            scale: factor of its coordinates, such as 0.001 for a file in millimetres.

        Raises:
            ConfigError: the scale or the placement is none.
            FileReadError: the mesh cannot be read.
        """
        load_mesh(path)
        return cls._make(name, "mesh", 3 * _read_sizes(name, (scale,), 1), placement, str(Path(path).absolute()))

    @classmethod
    def _make(cls, name: str, shape: Any, sizes: tuple[float, ...], placement: ArrayLike, file: str = "") -> Self:
        if not isinstance(name, str) or not name:
            raise ConfigError("name", name, "a text that is not empty")
        return cls(name, shape, sizes, _read_pose(name, placement), file)

    @property
    def placement(self) -> NDArray[np.float64]:
        """Return the placement in the world, (4, 4)."""
        return np.array(self.pose).reshape(4, 4)

    def at(self, placement: ArrayLike) -> Self:
        """Return the same obstacle at another placement. Raises `ConfigError` where it is none."""
        return dataclasses.replace(self, pose=_read_pose(self.name, placement))

    def make_geometry(self) -> ElementTree.Element:
        """Make the `<geometry>` of a URDF."""
        numbers, fields = list(map(repr, self.sizes)), dict[str, str]()
        if self.shape == "mesh":
            fields = {"filename": self.file, "scale": " ".join(numbers)}
        elif self.shape == "box":
            fields = {"size": " ".join(numbers)}
        else:
            fields.update(zip(("radius", "length"), numbers, strict=False))  # a sphere has no length
        geometry = ElementTree.Element("geometry")
        ElementTree.SubElement(geometry, self.shape, fields)
        return geometry


def _read_sizes(name: str, sizes: Sequence[float], count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, sizes))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(0.0 < number < math.inf for number in numbers):
        raise ConfigError(f"{name}.sizes", sizes, f"{count} finite number{'s' if count > 1 else ''} above 0")
    return numbers


def _read_pose(name: str, placement: ArrayLike) -> tuple[float, ...]:
    return tuple(read_placement(placement, f"{name}.placement").ravel().tolist())
