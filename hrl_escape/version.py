"""The version of hrl_escape, and those of what else decides its numbers."""

from __future__ import annotations

import functools

__version__ = "0.4.0"

LIBRARIES = ("gymnasium", "numpy", "scipy", "numba", "torch", "torchrl", "pybullet", "ompl", "pin")


@functools.cache
def find_versions() -> dict[str, str]:
    """Versions of the libraries that decide numbers, and of installed packages with agents, puzzles or observations."""
    from importlib.metadata import entry_points  # takes a tenth of the package's import

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
