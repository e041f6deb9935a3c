"""A disc: contact is where its axis enters a footprint grown by its radius, and it can always turn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

from typing_extensions import Self

from hrl_escape.env.bases.base import STANDS_IN, Base, TensorBase, make_cylinder_link
from hrl_escape.env.geometry import Footprint, compute_distance, compute_first_contact

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.env.tensor_geometry import RoomSolids, Shapes


def compute_disc_contact(x: float, y: float, cos: float, sin: float, size: tuple[float, ...], dx: float, dy: float,
                         shape: Footprint) -> float:
    """Return the fraction of a displacement until the disc meets the footprint, as in `Base.contact`."""
    return compute_first_contact(x, y, dx, dy, size[0], shape)


def measure_disc_gap(x: float, y: float, cos: float, sin: float, size: tuple[float, ...], shape: Footprint) -> float:
    """Return the signed gap to the footprint, m: negative if they overlap, as in `Base.gap`."""
    return compute_distance(x, y, shape) - size[0]


def compute_disc_distance(x: float, y: float, cos: float, sin: float, size: tuple[float, ...], shape: Footprint
                          ) -> float:
    """Return the distance to the footprint, m: 0 if they overlap, as in `Base.distance`."""
    return max(compute_distance(x, y, shape) - size[0], 0.0)


def does_disc_turn_meet(x: float, y: float, cos: float, sin: float, to_cos: float, to_sin: float, turn: float,
                        size: tuple[float, ...], shape: Footprint) -> bool:
    """Return false: the outline of a disc is the same at every heading. Arguments as in `Base.blocks_turn`."""
    return False


class Disc(Base):
    """A disc around the axis; `size` is its radius."""

    turns_anywhere = True
    front_field = width_field = "body_radius"
    contact, gap = staticmethod(compute_disc_contact), staticmethod(measure_disc_gap)
    distance, blocks_turn = staticmethod(compute_disc_distance), staticmethod(does_disc_turn_meet)
    symmetry = 0

    @classmethod
    def measure(cls, robot: Any) -> Self:
        """Return the base of a `RobotConfig`, without clearance."""
        return cls((robot.body_radius,))

    @property
    def outer_radius(self) -> float:
        """Radius of the disc, m."""
        return self.size[0]

    @property
    def inner_radius(self) -> float:
        """Radius of the disc, m."""
        return self.size[0]

    @property
    def front(self) -> float:
        """Radius of the disc, m."""
        return self.size[0]

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Empty: discs have no corners."""
        return ()

    def find_free_fraction(self, x: float, y: float, rotation: tuple[float, float], dx: float, dy: float,
                           shapes: Iterable[Footprint]) -> float:
        """Return the fraction, in [0, 1], of a displacement before the first contact with any footprint."""
        radius, least = self.size[0], 1.0
        for shape in shapes:
            met = compute_first_contact(x, y, dx, dy, radius, shape)
            if met < least:
                least = met
        return least

    def stands_in(self, x: float, y: float, rotation: tuple[float, float], shape: Footprint) -> bool:
        """Return whether the disc overlaps a footprint by more than `STANDS_IN`."""
        return compute_distance(x, y, shape) < self.size[0] - STANDS_IN

    def describe(self) -> str:
        """Return shape and radius in words, for messages."""
        return f"a body of radius {self.size[0]:g} m"

    def make_link(self, name: str, mass: float, height: float) -> ElementTree.Element:
        """Make the base's URDF link, upright on the floor; kg, m."""
        return make_cylinder_link(name, mass, self.size[0], height, f"0 0 {height / 2!r}", "0 0 0")

    def place(self, x: Tensor, y: Tensor, find_rotation: Callable[[], tuple[Tensor, Tensor]]) -> TensorBase:
        """Place the disc in each room of a batch; its heading has no effect."""
        return _TensorDisc(x, y, self.size[0])


class _TensorDisc(NamedTuple):
    """A disc in each room; see `TensorBase`."""

    x: Tensor  # centre, m, float64 (rooms,)
    y: Tensor  # centre, m, float64 (rooms,)
    radius: float  # equal in all rooms, m

    def find_free_fraction(self, dx: Tensor, dy: Tensor, solids: RoomSolids) -> Tensor:
        # Single precision finds the first solid. The contact with it is computed again in double precision, because
        # rounding errors would otherwise accumulate from contact to contact.
        import torch

        from hrl_escape.env.tensor_geometry import compute_first_contact, refine_first_contact, store

        motion = (self.x, self.y, dx, dy, self.radius)
        shares = store(compute_first_contact(*motion, solids.list_split()))
        nearly = shares.amin(0)
        numbers = torch.arange(len(shares), dtype=torch.int32, device=shares.device).unsqueeze(1)
        which = torch.where(shares == nearly, numbers, len(shares)).amin(0).to(torch.int64)
        nearly = torch.relu(nearly).to(torch.float64)
        exactly = refine_first_contact(*motion, solids.gather(which), nearly)[0].clamp(0.0, 1.0)
        exactly = torch.where((exactly - nearly).abs() < 1e-3, exactly, nearly)
        return store(torch.where(nearly < 1.0, exactly, nearly))  # it can pass one solid and still meet another

    def compute_first_contact(self, dx: Tensor, dy: Tensor, shapes: Shapes) -> Tensor:
        from hrl_escape.env.tensor_geometry import compute_first_contact

        return compute_first_contact(self.x, self.y, dx, dy, self.radius, shapes).clamp(min=0.0)

    def compute_distance(self, shapes: Shapes) -> Tensor:
        from hrl_escape.env.tensor_geometry import compute_distance

        return (compute_distance(self.x, self.y, shapes) - self.radius).clamp(min=0.0)

    def stands_in(self, shapes: Shapes) -> Tensor:
        from hrl_escape.env.tensor_geometry import compute_distance

        return compute_distance(self.x, self.y, shapes) < self.radius - STANDS_IN

    def is_turn_blocked(self, to_cos: Tensor, to_sin: Tensor, turn: Tensor, shapes: Shapes) -> Tensor:
        import torch

        return torch.zeros_like(shapes.x + self.x, dtype=torch.bool)
