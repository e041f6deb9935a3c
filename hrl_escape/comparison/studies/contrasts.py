"""Screening designs of Plackett and Burman, and the contrasts of their balanced blocks.

Up to 11 two-level factors in 12 rows, folded over into 24 (Plackett and Burman 1946; Montgomery, Design and Analysis of
Experiments, section 8.6). Main effects are then free of interactions of two factors (resolution IV), which are mixed
with each other only. Any three factors take all eight combinations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_FACTORS", "make_screening_design"]

MOST_FACTORS = 11
_GENERATOR = (1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1)
"""First row of the design in 12 rows; the next ten are its rotations, the last is all low."""


def make_screening_design(factors: int) -> NDArray[np.int64]:
    """Levels of the folded-over design of Plackett and Burman; the first row is all low, the last all high.

    Args:
        factors: k, at most `MOST_FACTORS`.

    Returns:
        (24, k) of -1 and 1; row 23 - i is row i with all signs turned.
    """
    if not 1 <= factors <= MOST_FACTORS:
        raise ValueError(f"{factors} factors do not fit: 1 to {MOST_FACTORS} do")
    half = np.array([[-1] * MOST_FACTORS, *(np.roll(_GENERATOR, shift) for shift in range(MOST_FACTORS))],
                    dtype=np.int64)[:, :factors]
    return np.concatenate([half, -half[::-1]])
