"""Placing of obstacles that keep a room solvable."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.geometry import (
    Neighbourhood,
    Solid,
    compute_distance,
    compute_distance_many,
    make_footprint,
    stack_footprints,
)
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.sampling.certificate import Floors, find_unmet
from hrl_escape.env.sampling.floorplan import Rejected
from hrl_escape.env.sampling.work import Work

__all__ = ["place_obstacles"]


def place_obstacles(config: RoomConfig, instance: RoomInstance, floors: Floors,
                    rng: np.random.Generator) -> tuple[RoomInstance, Floors]:
    """Add obstacles in batches; a batch that breaks the certificate is halved, a single one is drawn anew."""
    left, batch, failures = config.obstacles.count, max(1, config.obstacles.count // 4), 0
    while left:
        number = min(batch, left)
        obstacles: list[Solid] = []
        for _ in range(number):
            obstacles.append(_sample_obstacle(config, instance, obstacles, rng, floors.shut.work))
        candidate = dataclasses.replace(instance, solids=(*instance.solids, *obstacles))
        crowded = floors.extend(obstacles)
        if find_unmet(candidate, crowded) is None:
            instance, floors, left = candidate, crowded, left - number
            continue
        if number > 1:
            batch = max(1, number // 2)
            continue
        failures += 1
        if failures > 40:
            raise Rejected(f"{config.obstacles.count} obstacles must leave the way free "
                           f"(only {config.obstacles.count - left} did)")
    return instance, floors


def _sample_obstacle(config: RoomConfig, instance: RoomInstance, others: list[Solid], rng: np.random.Generator,
                     work: Work) -> Solid:
    """Sample an obstacle clear of starts, props, targets and the middle of the exit."""
    settings = config.obstacles
    body = instance.robot.outer_radius + 0.05
    keep = [(p.x, p.y, p.prop.half_size * 1.5 + 2.2 * body) for p in instance.props]
    keep.append((*instance.exit.centre, body))
    starts = np.array([(s.x, s.y) for s in instance.starts])
    standing = Neighbourhood([solid.footprint for solid in (*instance.solids, *others)])
    for _ in range(200):
        work.spend(40 + len(standing.footprints) // 4 + len(starts) // 20)
        is_cylinder = bool(rng.random() < settings.cylinder_share)
        half_x, half_y = (float(v) / 2 for v in rng.uniform(settings.size_min, settings.size_max, 2))
        x = float(rng.uniform(-instance.half_width, instance.half_width))
        y = float(rng.uniform(-instance.half_depth, instance.half_depth))
        yaw = 0.0 if settings.aligned else float(rng.uniform(-math.pi, math.pi))
        if is_cylinder:
            half_y, yaw = half_x, 0.0
        shape = make_footprint(x, y, half_x, half_y, yaw, is_cylinder)
        if any(compute_distance(a, b, shape) < room for a, b, room in keep):
            continue
        if (compute_distance_many(starts, stack_footprints([shape])) < body).any():
            continue
        around = math.hypot(half_x, half_y)
        if any(compute_distance(x, y, t.footprint) < around for t in instance.targets):
            continue
        apart = 0.5 * min(half_x, half_y)
        if any(compute_distance(x, y, other) < apart for other in standing.list_near(x, y, apart)):
            continue  # obstacles may touch, but none is inside another or a wall
        return Solid("cylinder" if is_cylinder else "box", x, y, half_x, half_y, yaw, settings.height, "obstacle")
    raise Rejected("obstacles must fit clear of the start, buttons, props and exit")
