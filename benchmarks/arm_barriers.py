"""Motions of `arm_tasks` that do not exist: `python -m benchmarks.arm_barriers FOLDER`.

The ranges of an arm's first two joints are divided into cells. A side of a cell is blocked if each posture on it, at
any angles of the other joints, is proved to collide. Two postures whose cells are separated by blocked sides have no
motion between them, at any clearance. A proof covers postures by boxes: if two bodies are deeper in each other at the
middle of a box than they can move apart within it, all its postures collide. Other boxes are halved. FOLDER is the
folder of `example-robot-data`.
"""

# pyright: reportAttributeAccessIssue=false
# (Pinocchio is compiled and carries no types)

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio
import tyro
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from benchmarks.arm_tasks import list_published, list_queries
from hrl_escape.cli import run_script
from hrl_escape.planning import Arm

SAMPLES, BOXES = 30, 400
"""Random postures that are tried on a side before its proof, and boxes of a proof."""
_NEAR = 1e-3  # m; coal's test of bodies that meet misses one in 20,000 without a margin, its distances do not


def is_blocked(arm: Arm, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Return whether all postures from `low` to `high`, (joints,), rad, are proved to collide."""
    rng = np.random.default_rng(0)
    if any(arm.is_free(rng.uniform(low, high), _NEAR) for _ in range(SAMPLES)):
        return False
    tests = arm._search.get_collisions(0.0)
    data, speeds = tests._geometry.createData(), tests._bounds.speeds[:, 3:]
    for request in data.collisionRequests:
        request.security_margin = _NEAR
    boxes, left = [(low, high)], BOXES
    while boxes:
        (low, high), left = boxes.pop(), left - 1
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        pinocchio.updateGeometryPlacements(tests._model, tests._data, tests._geometry, data,
                                           tests._make_q(0.0, 0.0, 0.0, middle.tolist()))
        pinocchio.computeCollisions(tests._geometry, data, False)
        meeting = [k for k, result in enumerate(data.collisionResults) if result.isCollision()]
        if left < 0 or not meeting:
            return False
        depths = [-pinocchio.computeDistance(tests._geometry, data, k).min_distance - speeds[k] @ half for k in meeting]
        if max(depths) <= 0.0:
            joint = int(np.argmax(speeds[meeting[int(np.argmax(depths))]] * half))
            left_end, right_end = high.copy(), low.copy()
            left_end[joint] = right_end[joint] = middle[joint]
            boxes += [(low, left_end), (right_end, high)]
    return True


def label_cells(arm: Arm, step: float) -> NDArray[np.int64]:
    """Return a number for each cell of the first two joints; cells of different numbers are separated."""
    low, high = arm.limits.T
    counts = np.ceil((high - low)[:2] / step).astype(int)
    numbers, open_sides = np.arange(counts.prod()).reshape(counts), list[tuple[int, int]]()
    for cell in np.ndindex(*counts):
        for axis in (0, 1):
            if cell[axis]:
                first, last = low.copy(), high.copy()
                first[:2] += step * np.array(cell)
                last[:2] = np.minimum(first[:2] + step, high[:2])
                last[axis] = first[axis]
                if not is_blocked(arm, first, last):
                    before = (cell[0] - (axis == 0), cell[1] - (axis == 1))
                    open_sides.append((int(numbers[before]), int(numbers[cell])))
    i, j = np.array(open_sides).T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(numbers.size, numbers.size))
    return connected_components(graph, directed=False)[1].reshape(counts)


def find_separated(arm: Arm, count: int, step: float) -> list[int]:
    """Return the numbers of the motions of `arm_tasks` that are proved not to exist."""
    arm, queries = list_queries(arm, count)
    labels, low = label_cells(arm, step), arm.limits[:2, 0]
    ends = [[labels[tuple(((end[:2] - low) / step).astype(int))] for end in query] for query in queries]
    return [number for number, (first, last) in enumerate(ends) if first != last]


@dataclasses.dataclass
class Args:
    """What to prove."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of example-robot-data."""
    robots: tuple[str, ...] = ("UR5", "UR10")
    """Names of `arm_tasks`."""
    plans: int = 50
    """Motions of each robot."""
    step: float = 0.05
    """Side of a cell, rad."""


def run(args: Args) -> int:
    """Print the motions that do not exist."""
    robots = list_published(args.folder / "robots" if (args.folder / "robots").is_dir() else args.folder)
    for name in args.robots:
        began = time.thread_time()
        separated = find_separated(robots[name](), args.plans, args.step)
        print(f"{name}: {len(separated)} of {args.plans} motions do not exist, numbers {separated}; "
              f"{time.thread_time() - began:.0f} CPU s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run_script(run))
