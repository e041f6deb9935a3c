"""Connected parts, waves and nearest cells of the floor's grid, compared with SciPy's."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from hrl_escape.env.floor_grid import label_parts, spread_waves
from hrl_escape.env.sampling.primitive_proof import read_nearest


def draw_floors(count: int):
    """Random grids, dense and sparse, down to a single cell."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield rng, rng.random(rng.integers(1, 24, 2)) < rng.choice([0.1, 0.4, 0.6, 0.8, 0.97])


def test_parts_have_the_numbers_of_scipys_labels():
    for _, free in draw_floors(150):
        assert np.array_equal(label_parts(free, corners=False), ndimage.label(free)[0])
        assert np.array_equal(label_parts(free, corners=True), ndimage.label(free, structure=np.ones((3, 3)))[0])


def test_waves_are_the_fewest_moves_and_cells_without_one_take_the_nearest():
    for rng, free in draw_floors(60):
        seeds = rng.random(free.shape) < 0.08
        seeds.flat[rng.integers(free.size)] = True
        numbers = np.arange(free.size).reshape(free.shape)
        down, right = free[1:] & free[:-1], free[:, 1:] & free[:, :-1]
        one, other = (np.concatenate(ends) for ends in ((numbers[1:][down], numbers[:, 1:][right]),
                                                        (numbers[:-1][down], numbers[:, :-1][right])))
        graph = sparse.csr_matrix((np.ones(len(one)), (one, other)), shape=(free.size, free.size))
        expected = csgraph.dijkstra(graph, directed=False, indices=np.flatnonzero(seeds), unweighted=True,
                                    min_only=True).reshape(free.shape)
        waves = spread_waves(free, seeds)
        assert np.array_equal(waves, expected)
        nearest = ndimage.distance_transform_edt(np.isinf(expected), return_distances=False, return_indices=True)
        found = [read_nearest(waves, i, j) for i, j in np.ndindex(free.shape)]
        assert found == expected[tuple(nearest)].ravel().tolist()


def test_a_grid_that_no_wave_reaches_has_no_nearest_cell():
    assert read_nearest(spread_waves(np.ones((5, 3), dtype=bool), np.zeros((5, 3), dtype=bool)), 4, 0) == np.inf
