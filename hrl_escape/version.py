"""The version of hrl_escape, and the versions of other software that affects its numbers."""

from __future__ import annotations

import functools

__version__ = "0.4.0"

LIBRARIES = ("gymnasium", "numpy", "scipy", "numba", "torch", "torchrl", "pybullet", "ompl", "pin")


@functools.cache
def find_versions() -> dict[str, str]:
    """Return the versions of libraries that affect numbers, and of installed packages with plugins."""
    from importlib.metadata import entry_points  # imported here: it takes a tenth of the package's import

    points = entry_points()
    groups = [group for group in points.groups if group.startswith("hrl_escape.")]
    plugins = {point.dist.name for group in groups for point in points.select(group=group) if point.dist is not None}
    return {name: _find_version(name) for name in (*LIBRARIES, *sorted(plugins))}


def _find_version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed as a package"
