"""Bases of robots: the outline on the floor, in numbers and in tensors, one file each.

No other module depends on a robot's shape: rules, engines, certificate and planners ask its `Base` where it fits,
what it meets first and what blocks its turns. A new base is one file and one line in `BASES`.
"""

from __future__ import annotations

from hrl_escape.env.bases.base import Base, TensorBase
from hrl_escape.env.bases.disc import Disc
from hrl_escape.env.bases.rectangle import RectangularBase

__all__ = ["BASES", "Base", "Disc", "RectangularBase", "TensorBase"]

BASES: dict[str, type[Base]] = {"disc": Disc, "rectangle": RectangularBase}
"""Base classes, keyed by the values of `robot.footprint`."""
