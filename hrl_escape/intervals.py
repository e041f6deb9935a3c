"""Mean of a few runs with Student's t interval, for numbers without known bounds such as returns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def compute_mean_interval(values: ArrayLike, level: float = 0.95
                          ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute means over the last axis with Student's t interval.

    Args:
        values: numbers of runs, (..., runs).
        level: confidence of the interval.

    Returns:
        Mean, low and high end, each float64 (...). One run gives no interval: both ends are the mean.
    """
    runs = np.asarray(values, dtype=np.float64)
    mean, count = runs.mean(axis=-1), runs.shape[-1]
    if count < 2:
        return mean, mean, mean
    from scipy import special  # pyright: ignore[reportMissingTypeStubs]  # slow to import

    reach = special.stdtrit(count - 1, (1 + level) / 2) * runs.std(axis=-1, ddof=1) / np.sqrt(count)
    return mean, mean - reach, mean + reach
