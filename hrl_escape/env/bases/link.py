"""Links of a URDF that are one solid cylinder or box, with its inertia."""

from __future__ import annotations

from xml.etree import ElementTree


def make_cylinder_link(name: str, mass: float, radius: float, length: float, xyz: str,
                       rpy: str) -> ElementTree.Element:
    """Make a link that is a cylinder along its own z, placed in the link's frame; kg, m, rad."""
    side = mass * (3 * radius**2 + length**2) / 12
    shape = f'<cylinder radius="{radius!r}" length="{length!r}"/>'
    return _make_link(name, mass, shape, (side, side, mass * radius**2 / 2), f'<origin xyz="{xyz}" rpy="{rpy}"/>')


def make_box_link(name: str, mass: float, size: tuple[float, float, float], xyz: str) -> ElementTree.Element:
    """Make a link that is a box along its own axes, placed in the link's frame; kg, m."""
    squares = [side**2 for side in size]
    x, y, z = (mass * (sum(squares) - square) / 12 for square in squares)
    return _make_link(name, mass, f'<box size="{" ".join(map(repr, size))}"/>', (x, y, z),
                      f'<origin xyz="{xyz}" rpy="0 0 0"/>')


def _make_link(name: str, mass: float, geometry: str, inertia: tuple[float, float, float],
               place: str) -> ElementTree.Element:
    (x, y, z), shape = inertia, f"{place}<geometry>{geometry}</geometry>"
    return ElementTree.fromstring(
        f'<link name="{name}"><inertial>{place}<mass value="{mass!r}"/>'
        f'<inertia ixx="{x!r}" iyy="{y!r}" izz="{z!r}" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial><visual>{shape}</visual><collision>{shape}</collision></link>"
    )
