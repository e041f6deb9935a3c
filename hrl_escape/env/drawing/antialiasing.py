"""Soft edges for a rendered picture: FXAA (Lottes, NVIDIA 2009), vectorised over the edge pixels.

Bullet's software renderer takes one sample a pixel, and four samples cost four times its
time. This looks for steps of brightness, follows each along the edge to both ends, and
mixes a pixel with its neighbour across the edge by where it lies between those ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.floating]
Places = NDArray[np.integer]

_LUMA = np.array((0.299, 0.587, 0.114), dtype=np.float32) / 255
_LEAST_CONTRAST, _RELATIVE_CONTRAST = 0.03, 0.1
_SEARCH = (1, 2, 3, 4, 5, 6, 8, 10, 14)  # pixels along the edge
_SUBPIXEL = 0.75


def soften_edges(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3) uint8 RGB, without stairs along its edges."""
    height, width = picture.shape[:2]
    margin = _SEARCH[-1] + 1  # edges go on straight beyond the border
    luma = np.pad(picture @ _LUMA, margin, mode="edge")
    stride = width + 2 * margin

    def shift_by(down: int, right: int) -> NDArray[np.floating]:
        return luma[margin + down : margin + down + height, margin + right : margin + right + width]

    middle, north, south, west, east = (shift_by(*by) for by in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)))
    high = np.maximum.reduce((middle, north, south, west, east))
    contrast = high - np.minimum.reduce((middle, north, south, west, east))
    rows, columns = np.nonzero(contrast > np.maximum(_LEAST_CONTRAST, _RELATIVE_CONTRAST * high))
    if not len(rows):
        return picture
    flat, at = luma.ravel(), (rows + margin) * stride + columns + margin
    n, s, w, e = flat[at - stride], flat[at + stride], flat[at - 1], flat[at + 1]
    nw, ne, sw, se = flat[at - stride - 1], flat[at - stride + 1], flat[at + stride - 1], flat[at + stride + 1]
    own = flat[at]

    level = 2 * abs(n + s - 2 * own) + abs(ne + se - 2 * e) + abs(nw + sw - 2 * w)
    upright = 2 * abs(w + e - 2 * own) + abs(nw + ne - 2 * n) + abs(sw + se - 2 * s)
    is_level = level >= upright
    across = np.where(is_level, stride, 1)  # step over the edge; the edge runs along the other axis
    along = np.where(is_level, 1, stride)
    before, after = np.where(is_level, n, w), np.where(is_level, s, e)
    is_before = abs(before - own) >= abs(after - own)
    across = np.where(is_before, -across, across)
    edge = (own + np.where(is_before, before, after)) / 2
    gradient = np.maximum(abs(before - own), abs(after - own)) / 4

    first, first_end = _follow(flat, at, across, -along, edge, gradient)
    second, second_end = _follow(flat, at, across, along, edge, gradient)
    near_end = np.where(first < second, first_end, second_end)
    shift = 0.5 - np.minimum(first, second) / (first + second)
    shift = np.where((near_end < 0.0) != (own < edge), shift, 0.0)  # this pixel is on the far side: leave it
    blend = (2 * (n + s + w + e) + nw + ne + sw + se) / 12
    rough = np.clip(abs(blend - own) / contrast[rows, columns], 0.0, 1.0)
    shift = np.maximum(shift, _SUBPIXEL * (rough * rough * (3 - 2 * rough)) ** 2)[:, None]

    other_row = np.clip(rows + np.where(is_level, np.sign(across), 0), 0, height - 1)
    other_column = np.clip(columns + np.where(is_level, 0, np.sign(across)), 0, width - 1)
    mixed = (1 - shift) * picture[rows, columns] + shift * picture[other_row, other_column]
    soft = picture.copy()
    soft[rows, columns] = (mixed + 0.5).astype(np.uint8)
    return soft


def _follow(luma: Values, at: Places, across: Places, along: Places, edge: Values, gradient: Values
            ) -> tuple[Values, Values]:
    """Walk along an edge until its brightness changes.

    Returns:
        How far its end is, in pixels, and the difference of brightness found there.
    """
    distance = np.full(len(at), _SEARCH[-1], dtype=np.float32)
    found = np.zeros(len(at), dtype=np.float32)
    going = np.arange(len(at))
    for step in _SEARCH:
        place = at[going] + step * along[going]
        change = (luma[place] + luma[place + across[going]]) / 2 - edge[going]
        found[going] = change
        ended = abs(change) >= gradient[going]
        distance[going[ended]] = step
        going = going[~ended]
    return distance, found
