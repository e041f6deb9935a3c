"""Reachability maps: from which places of the base, and how many of its headings, the hand reaches a point."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.planning.collision_map import CollisionMap, list_cells

__all__ = ["ReachMap", "make_halton", "map_reach"]

CONFIGURATIONS = 200_000
"""Configurations whose hand positions are looked at: points of a Halton sequence between the joint limits."""

_PRIMES = (2, 3, 5, 7, 11, 13, 17)


@dataclasses.dataclass(frozen=True, eq=False)
class ReachMap:
    """Share of the base's headings from which the hand reaches a point, by place of the base.

    Attributes:
        instance: the room.
        point: the point, (x, y, z), m.
        low: corner of the grid, shape (2,), m.
        cell: side of its square cells, m.
        share: of the headings, shape (columns, rows), columns along x; 0 where the base does not fit.
    """

    instance: RoomInstance
    point: tuple[float, float, float]
    low: NDArray[np.float64]
    cell: float
    share: NDArray[np.float64]

    def get_best(self) -> tuple[float, float]:
        """Place with the largest share, m."""
        i, j = np.unravel_index(int(self.share.argmax()), self.share.shape)
        x, y = (self.low + (np.array([i, j]) + 0.5) * self.cell).tolist()
        return x, y

    def draw(self, path: str | Path | None = None) -> Any:
        """Draw the map over the room's; PNG, SVG or PDF if a path is given. Returns the matplotlib figure."""
        from hrl_escape.env.drawing.maps import make_map, save_figure  # loads matplotlib

        figure = make_map(self.instance)
        axes = figure.axes[0]
        (x, y), (columns, rows) = self.low.tolist(), self.share.shape
        shown = np.ma.masked_equal(self.share.T, 0.0)
        image = axes.imshow(shown, extent=(x, x + columns * self.cell, y, y + rows * self.cell), origin="lower",
                            cmap="viridis", vmin=0.0, vmax=max(float(self.share.max()), 1e-9), alpha=0.75,
                            zorder=1.5, interpolation="nearest")
        axes.plot(self.point[0], self.point[1], "x", color="black", markersize=9, markeredgewidth=2, zorder=5)
        bar = figure.colorbar(image, cax=axes.inset_axes((0.3, 0.965, 0.4, 0.012)), orientation="horizontal")
        bar.set_label(f"share of headings from which the hand gets to the cross, {self.point[2]:.2g} m up", fontsize=7)
        bar.ax.tick_params(labelsize=6)
        if path is not None:
            save_figure(path, figure)
        return figure


def map_reach(instance: RoomInstance, rules: Rules, point: tuple[float, float, float], floor: CollisionMap,
              cell: float, tolerance: float) -> ReachMap:
    """Map from where the hand reaches a point; see `ArmPlanner.map_reach`."""
    low_angles, high_angles = np.array(rules.robot.limits).T
    samples = make_halton(CONFIGURATIONS, len(low_angles))
    hands = rules.robot.compute_hand(low_angles + (high_angles - low_angles) * samples)
    hands = hands[np.abs(hands[:, 2] - point[2]) <= tolerance, :2]
    low = np.array([-instance.reach_x, -instance.reach_y])
    shape = tuple(np.ceil(2 * np.array([instance.reach_x, instance.reach_y]) / cell).astype(int).tolist())
    counts = np.zeros(shape)
    for heading in range(rules.headings):
        cos, sin = rules.get_rotation(heading, 0.0)
        places = np.array(point[:2]) - hands @ np.array([[cos, sin], [-sin, cos]])
        cells = np.floor((places - low) / cell).astype(int)
        cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
        reached = np.zeros(shape, dtype=bool)
        reached[cells[:, 0], cells[:, 1]] = True
        counts += reached
    grid = list_cells((0, 0), shape)
    centres = np.add(low, (grid + 0.5) * cell, dtype=np.float64)
    free = floor.are_free(centres).reshape(shape)
    return ReachMap(instance, point, low, cell, np.where(free, counts / rules.headings, 0.0))


def make_halton(count: int, dimensions: int) -> NDArray[np.float64]:
    """First points of the Halton sequence in the unit cube, shape (count, dimensions); up to 7 dimensions."""
    points = np.zeros((count, dimensions))
    for k, prime in zip(range(dimensions), _PRIMES, strict=False):
        number, share = np.arange(1, count + 1), 1.0 / prime
        while number.any():
            points[:, k] += share * (number % prime)
            number, share = number // prime, share / prime
    return points
