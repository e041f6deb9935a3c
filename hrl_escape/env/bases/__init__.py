"""Bases of robots: outlines on the floor, in numbers and in tensors, one file each.

No other module depends on a robot's shape. Rules, engines, certificate and planners use its `Base` to compute where it
fits, what it meets first and what blocks its turns. A new base is one file and one call of `bases.register`, or an
entry point in the group `hrl_escape.bases`.
"""

from __future__ import annotations

from hrl_escape.env.bases.base import Base, TensorBase
from hrl_escape.env.bases.disc import Disc
from hrl_escape.env.bases.rectangle import RectangularBase
from hrl_escape.registry import Registry

__all__ = ["Base", "Disc", "RectangularBase", "TensorBase", "bases"]

bases: Registry[type[Base]] = Registry(
    "base", "a subclass of Base", lambda part: isinstance(part, type) and issubclass(part, Base))
"""Base classes, keyed by the values of `robot.footprint`."""
bases.register("disc", Disc)
bases.register("rectangle", RectangularBase)
