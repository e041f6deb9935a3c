"""Bases of robots: the outline on the floor, in numbers and in tensors, one file each.

Nothing else asks what shape a robot is: rules, engines, certificate and planners ask its `Base` where it fits, what it
meets first and what is in the way of its turns. A further base is its file and a line in `BASES`.
"""

from __future__ import annotations

from hrl_escape.env.bases.base import Base, TensorBase
from hrl_escape.env.bases.disc import Disc
from hrl_escape.env.bases.rectangle import RectangularBase

__all__ = ["BASES", "Base", "Disc", "RectangularBase", "TensorBase"]

BASES: dict[str, type[Base]] = {"disc": Disc, "rectangle": RectangularBase}
"""Bases by the name that `robot.footprint` has."""
