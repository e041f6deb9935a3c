"""Sampling: `generate(config, seed)` is a pure function from a schematic to a solvable instance.

A sample is kept only if its certificate holds: the start, a place from which each target is
touched, and the exit are connected for the robot's body, with the exit door shut until the
end. If no sample passes within a bounded number of tries, `GenerationError` says what failed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.floorplan import Face, Floorplan, Rejected, sample_floorplan
from hrl_escape.env.free_space import FreeSpace
from hrl_escape.env.geometry import Solid, compute_distance, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import PlacedProp, Rectangle, RoomInstance, Start, Target
from hrl_escape.env.puzzles.base import Panels, Place, Puzzle
from hrl_escape.env.robot import make_robot, sample_hand_positions
from hrl_escape.errors import ConfigError, GenerationError

__all__ = ["find_unmet_constraint", "generate"]

TRIES = 30
_START_TRIES = 100
_ARM_THICKNESS = 0.1  # m, from the line through an arm's joints
_ADVICE = "Make the room larger, or ask for fewer or smaller things in it."


def generate(config: RoomConfig, seed: int) -> RoomInstance:
    """Sample a solvable room instance.

    Args:
        config: the schematic.
        seed: instance seed, >= 0. The same config and seed give the same instance.

    Raises:
        GenerationError: no solvable room within a bounded number of tries.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**63:
        raise ConfigError("seed", seed, "a whole number from 0 to 2**63 - 1")
    puzzle = config.puzzle.make_puzzle(np.random.default_rng([int(seed), 0]))
    constraint = ""
    for attempt in range(TRIES):
        try:
            return _sample(config, int(seed), puzzle, np.random.default_rng([int(seed), 1, attempt]))
        except Rejected as rejected:
            constraint = str(rejected)
    raise GenerationError(constraint, TRIES, _ADVICE)


class _Floors(NamedTuple):
    """Free space with the exit door shut, and with it open (the same where there is no door)."""

    shut: FreeSpace
    opened: FreeSpace

    def extend(self, solids: Sequence[Solid]) -> _Floors:
        shut = self.shut.extend(solids)
        return _Floors(shut, shut if self.opened is self.shut else self.opened.extend(solids))


def _make_floors(instance: RoomInstance) -> _Floors:
    opened = FreeSpace(instance.reach_x, instance.reach_y, instance.robot.body_radius, instance.solids)
    return _Floors(opened.extend((instance.door,)) if instance.door else opened, opened)


def find_unmet_constraint(instance: RoomInstance) -> str | None:
    """Say which part of the solvability certificate an instance breaks; None if it holds.

    The certificate is about this room's geometry: connected floor for start, touching and
    exit, and under physics an arm that is not stuck in a wall. It does not search for a sequence of primitives.
    """
    return _find_unmet(instance, _make_floors(instance))


def _find_unmet(instance: RoomInstance, floors: _Floors) -> str | None:
    shut, opened = floors
    labels = {shut.find_label(start.x, start.y) for start in instance.starts}
    if 0 in labels or len(labels) != 1:
        return "every start must be free and on one connected floor"
    if not all(_has_arm_free(instance, start) for start in instance.starts):
        return "the arm must be clear of walls and obstacles at every start"
    label = labels.pop()
    for index, target in enumerate(instance.targets):
        if not _can_touch(instance, index, shut, label):
            return f"{target.name} must be touchable from floor connected with the start"
    start = instance.starts[0]
    label = opened.find_label(start.x, start.y)
    if not any(opened.find_label(x, y) == label for x, y in _points_in(instance.exit)):
        return "the exit must be connected with the start"
    return None


def _points_in(area: Rectangle) -> list[tuple[float, float]]:
    x, y = area.centre
    shares = (0.0, -0.5, 0.5, -0.95, 0.95)
    half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
    return [(x + a * half_x, y + b * half_y) for a in shares for b in shares]


def _has_arm_free(instance: RoomInstance, start: Start) -> bool:
    """Whether the arm at home is clear of what stands; where no rigid bodies push, arms pass through everything."""
    if instance.dynamics.kind != "physics" or not instance.robot.joints:
        return True
    robot = make_robot(instance.robot)
    elbows, thick = robot.compute_elbows(robot.home), max(instance.robot.hand_radius, _ARM_THICKNESS)
    solids = (*instance.solids, *((instance.door,) if instance.door else ()))
    standing = [solid.footprint for solid in solids if solid.height > elbows[:, 2].min() - thick]
    heading = start.heading_steps * math.radians(instance.robot.turn_step_deg) + start.heading_offset
    cos, sin = math.cos(heading), math.sin(heading)
    longest = np.linalg.norm(np.diff(elbows, axis=0), axis=1).max()
    along = np.linspace(0.0, 1.0, math.ceil(longest / thick) + 1)[:, None]
    points = np.concatenate([a + along * (b - a) for a, b in zip(elbows[:-1], elbows[1:], strict=True)])[:, :2]
    points = (start.x, start.y) + points @ np.array([[cos, sin], [-sin, cos]])
    return not standing or bool((compute_distance_many(points, stack_footprints(standing)) > thick).all())


# --- touching ------------------------------------------------------------------------------


def _can_touch(instance: RoomInstance, index: int, space: FreeSpace, label: int) -> bool:
    if instance.dynamics.press_with == "hand":
        return _can_touch_by_hand(instance, instance.targets[index], space, label)
    return _can_touch_by_body(instance, instance.targets[index], space, label)


def _can_touch_by_body(instance: RoomInstance, target: Target, space: FreeSpace, label: int) -> bool:
    """Look for a touching stretch round the target, a few neighbouring places long."""
    reach = instance.compute_press_reach(target)
    if reach < 0.0:
        raise Rejected(f"{target.name} must hang low enough for the body to touch it")
    good = 0
    for share in (0.999, 0.9, 0.5, 0.0):
        points = _outline(target, reach * share if share else 1e-6)
        for x, y in points[space.is_clear(points)]:
            good += space.find_label(float(x), float(y)) == label
            if good >= 3:
                return True
    return False


def _outline(target: Target, distance: float) -> NDArray[np.float64]:
    """Points at a distance round a target's footprint, at most 0.1 m (or 1/200 of it) apart."""
    spacing = max(0.1, 4 * (target.half_x + target.half_y + distance) / 200)
    points = []
    for sign_x, sign_y, along_x in ((1, 1, True), (1, -1, True), (1, 1, False), (-1, 1, False)):
        half, away = (target.half_x, target.half_y) if along_x else (target.half_y, target.half_x)
        steps = np.linspace(-half, half, max(3, math.ceil(2 * half / spacing) + 1))
        side = np.full_like(steps, (sign_y if along_x else sign_x) * (away + distance))
        points.append(np.stack([steps, side] if along_x else [side, steps], axis=1))
    angles = np.linspace(0, math.tau, 32, endpoint=False)
    round_corner = distance * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points.append(round_corner + np.sign(round_corner) * (target.half_x, target.half_y))
    cos, sin = math.cos(target.yaw), math.sin(target.yaw)
    return np.concatenate(points) @ np.array([[cos, sin], [-sin, cos]]) + (target.x, target.y)


def _can_touch_by_hand(instance: RoomInstance, target: Target, space: FreeSpace, label: int) -> bool:
    """Look for a free cell, a heading on the lattice and a joint configuration that touch."""
    robot = make_robot(instance.robot)
    hands = sample_hand_positions(robot, 4000)
    limit = 0.9 * (instance.robot.hand_radius + instance.dynamics.press_margin)
    hands = hands[np.abs(hands[:, 2] - target.z) <= target.half_z]
    if not len(hands):
        return False
    lengths, bearings = np.hypot(hands[:, 0], hands[:, 1]), np.arctan2(hands[:, 1], hands[:, 0])
    cells = space.get_cells(label)
    centres = space.get_centres(cells)
    shape = stack_footprints([target.footprint])
    away = compute_distance_many(centres, shape)
    near = centres[away <= lengths.max() + limit]
    turn = math.radians(instance.robot.turn_step_deg)
    for x, y in near[:: max(1, len(near) // 60)]:
        aim = math.atan2(target.y - y, target.x - x)
        headings = np.round((aim - bearings) / turn) * turn
        points = np.stack([x + lengths * np.cos(headings + bearings), y + lengths * np.sin(headings + bearings)], 1)
        if (compute_distance_many(points, shape) <= limit).any():
            return True
    return False


# --- sampling ------------------------------------------------------------------------------


def _sample(config: RoomConfig, seed: int, puzzle: Puzzle, rng: np.random.Generator) -> RoomInstance:
    plan = sample_floorplan(config, rng)
    targets = _place_targets(config, puzzle, plan, rng)
    instance = RoomInstance(
        name=config.name, seed=seed, half_width=config.room.width / 2, half_depth=config.room.depth / 2,
        wall_height=config.room.wall_height, solids=plan.solids, door=plan.door, targets=targets,
        props=tuple(PlacedProp(prop) for prop in puzzle.props), exit=plan.exit, starts=(_fixed_start(config),),
        robot=config.robot, puzzle=puzzle, reward=config.reward, dynamics=config.dynamics, horizon=config.horizon,
    )
    instance = _place_start(config, instance, rng)
    instance = _place_props(instance, rng)
    unmet = find_unmet_constraint(instance)
    if unmet:
        raise Rejected(unmet)
    return _place_obstacles(config, instance, rng)


def _fixed_start(config: RoomConfig) -> Start:
    turns = round(360 / config.robot.turn_step_deg)
    heading = config.start.heading_deg / config.robot.turn_step_deg
    offset = math.radians((heading - round(heading)) * config.robot.turn_step_deg)
    return Start(config.start.x, config.start.y, round(heading) % turns, offset if abs(offset) > 1e-12 else 0.0)


def _place_targets(config: RoomConfig, puzzle: Puzzle, plan: Floorplan, rng: np.random.Generator) -> tuple[Target, ...]:
    panels = config.puzzle.panels
    if panels is None:
        return ()
    if not isinstance(panels.places, str):
        places = panels.places
    elif panels.places == "paper":
        places = _paper_places(config, panels)
    else:
        targets: list[Target] = []
        for name in puzzle.target_names:
            targets.append(_hang_anywhere(config, panels, name, plan, targets, rng))
        return tuple(targets)
    names = puzzle.target_names
    return tuple(_make_target(name, panels, p.x, p.y, p.z if p.z is not None else panels.centre_height,
                              math.radians(p.yaw_deg)) for name, p in zip(names, places, strict=False))


def _make_target(name: str, panels: Panels, x: float, y: float, z: float, yaw: float) -> Target:
    return Target(name, x, y, z, panels.width / 2, panels.thickness / 2, panels.height / 2, yaw)


def _paper_places(config: RoomConfig, panels: Panels) -> tuple[Place, ...]:
    """Left wall centre, back wall centre, front wall at a quarter, right wall centre (paper, figure 1)."""
    inset = panels.thickness / 2 if panels.inset is None else panels.inset
    x, y = config.room.width / 2 - inset, config.room.depth / 2 - inset
    return (Place(0.0, y, 0.0), Place(-x, 0.0, 90.0), Place(x, -config.room.depth / 4, 90.0), Place(0.0, -y, 0.0))


def _hang_anywhere(config: RoomConfig, panels: Panels, name: str, plan: Floorplan, others: list[Target],
                   rng: np.random.Generator) -> Target:
    """Hang a panel on a random wall: no overlap with others, not in the exit."""
    faces = [f for f in plan.faces if f.length >= panels.width]
    if not faces:
        raise Rejected(f"{name} must fit onto a wall")
    room = np.array([f.length - panels.width + 1e-3 for f in faces])
    inset = panels.thickness / 2 if panels.inset is None else panels.inset
    for _ in range(200):
        face: Face = faces[int(rng.choice(len(faces), p=room / room.sum()))]
        along = panels.width / 2 + float(rng.uniform(0.0, face.length - panels.width))
        z = panels.centre_height + float(rng.uniform(-panels.height_spread, panels.height_spread))
        cos, sin = round(math.cos(face.yaw), 15), round(math.sin(face.yaw), 15)
        target = _make_target(name, panels, face.x + cos * along - sin * inset, face.y + sin * along + cos * inset,
                              max(z, panels.height / 2), face.yaw)
        radius = math.hypot(target.half_x, target.half_y)
        crowded = any(math.hypot(target.x - o.x, target.y - o.y) < radius + math.hypot(o.half_x, o.half_y)
                      for o in others)
        exit_x, exit_y = plan.exit.centre
        area = make_footprint(exit_x, exit_y, plan.exit.x_max - exit_x, plan.exit.y_max - exit_y)
        if not crowded and compute_distance(target.x, target.y, area) > radius:
            return target
    raise Rejected(f"{len(others) + 1} buttons must fit onto the walls without overlap, outside the exit")


def _place_start(config: RoomConfig, instance: RoomInstance, rng: np.random.Generator) -> RoomInstance:
    if config.start.place == "fixed":
        return instance
    space = _make_floors(instance).shut
    labels, counts = np.unique(space.labels[space.labels > 0], return_counts=True)
    if not len(labels):
        raise Rejected("the body must fit somewhere")
    centres = space.get_centres(space.get_cells(int(labels[counts.argmax()])))
    area = instance.exit
    outside = ~((centres[:, 0] >= area.x_min) & (centres[:, 0] <= area.x_max)
                & (centres[:, 1] >= area.y_min) & (centres[:, 1] <= area.y_max))
    away = np.ones(len(centres), dtype=bool)
    if instance.targets:
        shapes = stack_footprints([t.footprint for t in instance.targets])
        away = compute_distance_many(centres, shapes) > instance.robot.body_radius + instance.dynamics.press_margin
    for allowed in (outside & away, away, np.ones_like(away)):
        if allowed.any():
            centres = centres[allowed]
            break
    turns = round(360 / instance.robot.turn_step_deg)
    starts = [
        Start(float(x), float(y), int(rng.integers(turns)))
        for x, y in centres[rng.integers(len(centres), size=config.start.choices)]
    ]
    for number in range(len(starts)):
        for _ in range(_START_TRIES):
            if _has_arm_free(instance, starts[number]):
                break
            x, y = centres[rng.integers(len(centres))].tolist()
            starts[number] = Start(x, y, int(rng.integers(turns)))
    return dataclasses.replace(instance, starts=tuple(starts))


def _place_props(instance: RoomInstance, rng: np.random.Generator) -> RoomInstance:
    """Put props on the floor, blocks with room to get behind them."""
    if not instance.props:
        return instance
    taken = [(s.x, s.y, instance.robot.body_radius) for s in instance.starts[:1]]
    walls = stack_footprints([solid.footprint for solid in instance.solids])
    placed = []
    for entry in instance.props:
        size = entry.prop.half_size * math.sqrt(2)
        need = size + (2.2 * instance.robot.body_radius + 0.3 if entry.prop.kind == "block" else 0.3)
        for _ in range(300):
            x = float(rng.uniform(-instance.half_width, instance.half_width))
            y = float(rng.uniform(-instance.half_depth, instance.half_depth))
            free = compute_distance_many(np.array([[x, y]]), walls)[0] >= need
            if free and all(math.hypot(x - a, y - b) >= size + r + 0.3 for a, b, r in taken):
                taken.append((x, y, size))
                placed.append(PlacedProp(entry.prop, x, y, 0.0))
                break
        else:
            raise Rejected(f"{entry.prop.name} must fit onto the floor")
    return dataclasses.replace(instance, props=tuple(placed))


# --- obstacles -----------------------------------------------------------------------------


def _place_obstacles(config: RoomConfig, instance: RoomInstance, rng: np.random.Generator) -> RoomInstance:
    """Add obstacles in batches; a batch that breaks the certificate is halved, a single one is drawn anew."""
    floors = _make_floors(instance)
    left, batch, failures = config.obstacles.count, max(1, config.obstacles.count // 4), 0
    while left:
        number = min(batch, left)
        obstacles: list[Solid] = []
        for _ in range(number):
            obstacles.append(_sample_obstacle(config, instance, obstacles, rng))
        candidate = dataclasses.replace(instance, solids=(*instance.solids, *obstacles))
        crowded = floors.extend(obstacles)
        if _find_unmet(candidate, crowded) is None:
            instance, floors, left = candidate, crowded, left - number
            continue
        if number > 1:
            batch = max(1, number // 2)
            continue
        failures += 1
        if failures > 40:
            raise Rejected(f"{config.obstacles.count} obstacles must leave the way free "
                           f"(only {config.obstacles.count - left} did)")
    return instance


def _sample_obstacle(config: RoomConfig, instance: RoomInstance, others: list[Solid],
                     rng: np.random.Generator) -> Solid:
    """One obstacle that does not stand on a start, a prop, a target or the middle of the exit."""
    settings = config.obstacles
    body = instance.robot.body_radius + 0.05
    keep = [(s.x, s.y, body) for s in instance.starts]
    keep += [(p.x, p.y, p.prop.half_size * 1.5 + 2.2 * body) for p in instance.props]
    keep.append((*instance.exit.centre, body))
    standing = stack_footprints([solid.footprint for solid in (*instance.solids, *others)])
    for _ in range(200):
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
        around = math.hypot(half_x, half_y)
        if any(compute_distance(x, y, t.footprint) < around for t in instance.targets):
            continue
        if (compute_distance_many(np.array([[x, y]]), standing) < 0.5 * min(half_x, half_y)).any():
            continue  # obstacles may touch, but none hides in another or in a wall
        return Solid("cylinder" if is_cylinder else "box", x, y, half_x, half_y, yaw, settings.height, "obstacle")
    raise Rejected("obstacles must find places beside the start, buttons, props and exit")
