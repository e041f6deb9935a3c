"""Durations of actions by the pose in which they start, learned apart from outcomes.

An action that ends at about the same pose every time leaves the robot at a place of its own. From place to place the
mean of the durations seen counts; elsewhere a straight line of duration over distance, fitted to the history. Without
a pose every action has its mean duration.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["DurationHistory", "DurationModel", "fit_durations"]

NEAR = 0.15
"""A pose belongs to a place within this share of the distance that poses are apart on average."""


class DurationHistory(NamedTuple):
    """Decisions in the order they were made, none cut inside.

    Attributes:
        starts: (decisions, pose) before each.
        actions: (decisions,).
        ends: (decisions, pose) after each.
        durations: (decisions,), primitives.
        previous: (decisions,), the action before in the same episode, or -1.
    """

    starts: NDArray[np.float64]
    actions: NDArray[np.int64]
    ends: NDArray[np.float64]
    durations: NDArray[np.float64]
    previous: NDArray[np.int64]


class DurationModel:
    """Durations between places; made by `fit_durations`.

    Args:
        table: (actions + 1, actions), primitives of each action from each place; the last row from nowhere special.
        places: (actions,), the row that holds after each action.
        homes: (actions, pose), where each action ends.
        weights: (pose,), how much each number of the pose counts in a distance.
        line: duration = line[0] + line[1] * distance.
        near: see `NEAR`, in units of that distance.
    """

    def __init__(
        self,
        table: NDArray[np.float64],
        places: NDArray[np.int64],
        homes: NDArray[np.float64],
        weights: NDArray[np.float64],
        line: tuple[float, float],
        near: float,
    ) -> None:
        self._table, self.places, self._homes = table, places, homes
        self._weights, self._line, self._near = weights, line, near

    def compute_durations(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """`table` with a last row that holds at this pose."""
        has_home = self.places < len(self.places)
        if not has_home.any():
            return self._table
        away = np.linalg.norm((self._homes - pose) * self._weights, axis=1)
        table = self._table.copy()
        table[-1] = np.where(has_home, _predict(self._line, away), self._table[-1])
        nearest = int(np.where(has_home, away, np.inf).argmin())
        if away[nearest] <= self._near:
            table[-1] = table[nearest]
        return table


def _predict(line: tuple[float, float], distance: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(line[0] + line[1] * distance, 1.0)


def fit_durations(history: DurationHistory, actions: int) -> DurationModel:
    """Fit durations to a history.

    Args:
        history: decisions; may be empty.
        actions: how many there are.
    """
    starts, chosen, ends, duration, previous = history
    if not len(chosen):
        return DurationModel(
            np.ones((actions + 1, actions)), np.full(actions, actions), np.zeros((actions, 0)), np.zeros(0), (1, 0), 0
        )
    counts = np.bincount(chosen, minlength=actions)
    means = np.full(actions, duration.mean())
    means[counts > 0] = (np.bincount(chosen, duration, actions) / np.maximum(counts, 1))[counts > 0]
    table = np.tile(means, (actions + 1, 1))
    homes = np.zeros((actions, ends.shape[1]))
    np.add.at(homes, chosen, ends)
    homes /= np.maximum(counts, 1)[:, None]
    spread, scatter = ends.std(axis=0), np.sqrt(((ends - homes[chosen]) ** 2).mean(axis=0))
    weights = (scatter < 0.5 * spread).astype(np.float64)  # numbers in which actions end alike: not the heading
    if len(chosen) < 3 or not weights.any():
        return DurationModel(table, np.full(actions, actions), homes, weights, (float(duration.mean()), 0.0), 0.0)
    scatters = np.linalg.norm((ends - homes[chosen]) * weights, axis=1)
    width = np.linalg.norm((ends - ends.mean(axis=0)) * weights, axis=1).mean()
    own = np.bincount(chosen, scatters, actions) / np.maximum(counts, 1)
    has_home = (counts > 0) & (own <= NEAR * width)
    places = np.where(has_home, np.arange(actions), actions)
    known = has_home[chosen]
    distance = np.linalg.norm((starts - homes[chosen]) * weights, axis=1)
    line = (float(duration.mean()), 0.0)
    if known.sum() >= 2 and distance[known].std() > 1e-9:
        design = np.column_stack([np.ones(known.sum()), distance[known]])
        offset, slope = np.linalg.lstsq(design, duration[known], rcond=None)[0]
        line = (float(offset), float(slope)) if slope > 0 else line
    between = np.linalg.norm((homes[:, None] - homes[None]) * weights, axis=2)
    pairs = has_home[:, None] & has_home[None]
    table[:-1] = np.where(pairs, _predict(line, between), table[:-1])
    travelled = previous >= 0
    cells = previous[travelled] * actions + chosen[travelled]
    seen = np.bincount(cells, minlength=actions * actions).reshape(actions, actions)
    total = np.bincount(cells, duration[travelled], actions * actions).reshape(actions, actions)
    table[:-1] = np.where(seen > 0, total / np.maximum(seen, 1), table[:-1])
    return DurationModel(table, places, homes, weights, line, NEAR * float(width))
