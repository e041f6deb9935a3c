"""Sampling: `generate(config, seed)` is a pure function from a room configuration to a solvable instance.

A sample is accepted if its certificate holds. The start, a touching place for each target, and the exit must be
connected for the robot's body, with the exit door shut until the end, and primitives must solve the room
(`primitive_proof.py`). If no sample passes within a bounded number of tries and a bounded amount of work,
`GenerationError` names the failure.

With doors between rooms, an order of opening them is drawn first. Doors are then placed outwards from
the room of the starts in that order. A target is only placed in rooms that are open by the time the order needs it, and
the order therefore solves the room. Doorways join the rooms to a tree: one way, with fixed doors, leads to each room.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, PASSAGE_SLACK, RoomConfig
from hrl_escape.env.geometry import (
    Neighbourhood,
    Solid,
    compute_distance,
    compute_distance_many,
    make_footprint,
    stack_footprints,
)
from hrl_escape.env.instance import PlacedProp, Rectangle, RoomInstance, SpaceLayout, Start, Target, does_base_fit
from hrl_escape.env.noise import check_instance_seed
from hrl_escape.env.puzzles.base import Pads, Panels, Place, Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.cues import compute_depths
from hrl_escape.env.puzzles.maps import GridMap
from hrl_escape.env.puzzles.mixins import Doored, Graphed, Mapped, Propped, get_mixin
from hrl_escape.env.sampling.certificate import (
    Floors,
    FreeSpace,
    OutOfWork,
    Work,
    find_unmet,
    has_arm_free,
    make_floors,
)
from hrl_escape.env.sampling.floorplan import Face, Floorplan, Rejected, compute_cell, is_whole_floor, sample_floorplan
from hrl_escape.env.sampling.primitive_proof import find_unproven
from hrl_escape.errors import ConfigError, GenerationError
from hrl_escape.settings import fill_ranges, list_ranges

TRIES = 30
LARGEST_WORK = 1_600_000
"""Largest amount of work for a room, in units of about a microsecond."""
KEPT_ROOMS = 64
"""Number of recent rooms in the cache."""
_START_TRIES = 100
_THING_HEIGHT = 0.4  # m, height of a thing in a cell
_PAD_HEIGHT = 0.02  # m, half the height of a pad above the floor
_ADVICE = "Make the room larger, or ask for fewer or smaller things in it."


def generate(config: RoomConfig, seed: int) -> RoomInstance:
    """Sample a solvable room instance, or return a recent one from the cache.

    Args:
        config: the room configuration.
        seed: instance seed, >= 0. Equal configurations and seeds give equal instances.

    Raises:
        GenerationError: no solvable room within a bounded number of tries.
    """
    if not isinstance(config, RoomConfig):
        raise ConfigError("config", config, "a RoomConfig")
    seed = check_instance_seed(seed)
    try:
        hash(config)
    except TypeError:  # settings of other packages may contain unhashable tables
        return _sample_room.__wrapped__(config, seed)
    return _sample_room(config, seed)


@functools.lru_cache(KEPT_ROOMS)
def _sample_room(config: RoomConfig, seed: int) -> RoomInstance:
    """First sample whose certificate holds."""
    frame = make_frame(config)
    config, puzzle = sample_puzzle(config, seed)
    constraint, work = "a room must be found with a bounded amount of work", Work(LARGEST_WORK)
    for attempt in range(TRIES):
        try:
            room = _sample(config, seed, puzzle, np.random.default_rng([seed, 1, attempt]), work)
            return dataclasses.replace(room, shared=frame) if frame else room
        except Rejected as rejected:
            constraint = str(rejected)
        except OutOfWork:
            raise GenerationError(constraint, attempt + 1, _ADVICE) from None
    raise GenerationError(constraint, TRIES, _ADVICE)


# --- ranges of a room configuration -----------------------------------------------------------------


def sample_puzzle(config: RoomConfig, seed: int) -> tuple[RoomConfig, Puzzle]:
    """Sample the numbers and the puzzle of an instance, in a fraction of the time of `generate`.

    Returns the room configuration with numbers instead of ranges, and the instance's puzzle.
    """
    rng = np.random.default_rng([seed, 2])
    config = fill_ranges(config, {path: _draw(between.low, between.high, rng)
                                  for path, between in list_ranges(config).items()})
    return config, config.puzzle.make_puzzle(np.random.default_rng([seed, 0]))


def _draw(low: float, high: float, rng: np.random.Generator) -> float:
    """Draw a number from a range uniformly, ends included."""
    if isinstance(low, int) and isinstance(high, int):
        return int(rng.integers(low, high, endpoint=True))
    return float(rng.uniform(low, high))


def make_frame(config: RoomConfig) -> SpaceLayout | None:
    """Make the layout that all instances share, or None if they all have the same size.

    Instances differ in size if the room configuration has ranges, or a door in a random wall, because the exit behind
    it adds floor on that side.
    """
    ranges = list_ranges(config)
    has_random_door = config.exit.door and config.exit.place == "random"
    if not ranges and not has_random_door:
        return None
    least = fill_ranges(config, {path: between.low for path, between in ranges.items()})
    most = fill_ranges(config, {path: between.high for path, between in ranges.items()})
    reach = np.array([most.room.width / 2, most.room.depth / 2])
    if has_random_door:
        reach += most.room.wall_thickness + most.exit.depth
    elif most.exit.place == "fixed":
        for exit_ in (least.exit, most.exit):
            reach = np.maximum(reach, [abs(exit_.x) + most.exit.width / 2, abs(exit_.y) + most.exit.depth / 2])
    puzzle = most.puzzle.make_puzzle(np.random.default_rng(0))
    bounds = tuple((min(low, 0.0), max(high, 0.0)) for low, high in puzzle.bounds)  # absent numbers are 0
    return SpaceLayout(float(reach[0]), float(reach[1]), most.room.wall_height, puzzle.target_names, bounds)


# --- sampling ------------------------------------------------------------------------------


def _sample(config: RoomConfig, seed: int, puzzle: Puzzle, rng: np.random.Generator, work: Work) -> RoomInstance:
    plan = sample_floorplan(config, rng, puzzle)
    doors = sample_doors(config, puzzle, plan, rng)
    targets = _place_targets(config, puzzle, plan, doors, rng)
    instance = RoomInstance(
        name=config.name, seed=seed, half_width=config.room.width / 2, half_depth=config.room.depth / 2,
        wall_height=config.room.wall_height, solids=plan.solids, door=plan.door,
        inner_doors=_list_inner_doors(config, puzzle) or doors.solids,
        ways=doors.list_ways(targets, plan.exit, config.robot.outer_radius), targets=targets,
        props=tuple(map(PlacedProp, get_mixin(puzzle, Propped).props)), exit=plan.exit,
        starts=(_fixed_start(config, puzzle),),
        robot=config.robot, puzzle=puzzle, reward=config.reward, dynamics=config.dynamics, horizon=config.horizon,
    )
    floors = make_floors(instance, work)
    instance = _place_start(config, instance, floors.shut, doors, rng)
    instance = _place_props(instance, rng)
    unmet = find_unmet(instance, floors)
    if unmet:
        raise Rejected(unmet)
    instance, floors = _place_obstacles(config, instance, floors, rng)
    unproven = find_unproven(instance, floors)
    if unproven:
        raise Rejected(unproven)
    return instance


def _list_inner_doors(config: RoomConfig, puzzle: Puzzle) -> tuple[Solid, ...]:
    """One box for each blockable cell of the puzzle's map: as high as the walls for doors, low for things."""
    level = get_mixin(puzzle, Mapped)
    if not level.map_rows:
        return ()
    grid, side = GridMap(level.map_rows), config.room.cell
    size = grid.columns * side, len(grid.rows) * side
    if size != (config.room.width, config.room.depth):
        raise ConfigError("room.width, room.depth", (config.room.width, config.room.depth),
                          f"{size[0]:g} and {size[1]:g} m: cells of {side:g} m for all of the puzzle's map")
    thing = Solid("box", half_x=side / 2, half_y=side / 2, height=_THING_HEIGHT)
    door = dataclasses.replace(thing, height=config.room.wall_height, role="door")
    places = ((cell, *compute_cell(config, cell)) for cell in level.blockable_cells)
    return tuple(dataclasses.replace(door if cell in grid.doors else thing, x=x, y=y) for cell, x, y in places)


def _fixed_start(config: RoomConfig, puzzle: Puzzle) -> Start:
    turns = round(360 / config.robot.turn_step_deg)
    if rows := get_mixin(puzzle, Mapped).map_rows:
        grid = GridMap(rows)
        return Start(*compute_cell(config, grid.start), grid.heading * turns // 4)
    heading = config.start.heading_deg / config.robot.turn_step_deg
    offset = math.radians((heading - round(heading)) * config.robot.turn_step_deg)
    return Start(config.start.x, config.start.y, round(heading) % turns, offset if abs(offset) > 1e-12 else 0.0)


def _place_targets(config: RoomConfig, puzzle: Puzzle, plan: Floorplan, doors: DoorPlan, rng: np.random.Generator
                   ) -> tuple[Target, ...]:
    if cells := get_mixin(puzzle, Mapped).target_cells:
        pads = Pads(config.room.cell, config.room.cell)
        return tuple(_make_pad(pads, name, *compute_cell(config, cell), 0.0)
                     for name, cell in zip(puzzle.target_names, cells, strict=True))
    names = tuple(name for name in puzzle.target_names if name not in puzzle.pad_names)
    hung = _hang_panels(config, names, plan, doors, rng)
    if isinstance(config.puzzle, ButtonsConfig) and config.puzzle.positional_cues.sections:
        depths = compute_depths(len(hung), get_mixin(puzzle, Graphed).edges)
        dealt = config.puzzle.positional_cues.deal([(target.x, target.y) for target in hung], depths, rng)
        return tuple(dataclasses.replace(hung[place], name=name) for place, name in zip(dealt, names, strict=True))
    if not puzzle.pad_names:
        return hung
    placed = {target.name: target for target in (*hung, *_lay_pads(config, puzzle.pad_names, plan, doors, hung, rng))}
    return tuple(placed[name] for name in puzzle.target_names)


def _hang_panels(config: RoomConfig, names: tuple[str, ...], plan: Floorplan, doors: DoorPlan,
                 rng: np.random.Generator) -> tuple[Target, ...]:
    panels = config.puzzle.panels
    if panels is None:
        return ()
    if not isinstance(panels.places, str):
        places = panels.places
    elif panels.places == "paper":
        places = _paper_places(config, panels)
    else:
        targets: list[Target] = []
        for name in names:
            targets.append(_hang_anywhere(config, panels, name, plan, doors, targets, rng))
        return tuple(targets)
    return tuple(_make_target(name, panels, p.x, p.y, p.z if p.z is not None else panels.centre_height,
                              math.radians(p.yaw_deg)) for name, p in zip(names, places, strict=False))


def _make_target(name: str, panels: Panels, x: float, y: float, z: float, yaw: float) -> Target:
    return Target(name, x, y, z, panels.width / 2, panels.thickness / 2, panels.height / 2, yaw)


def _paper_places(config: RoomConfig, panels: Panels) -> tuple[Place, ...]:
    """Middle of the left and back walls, quarter of the front wall, middle of the right wall (paper, figure 1)."""
    inset = panels.thickness / 2 if panels.inset is None else panels.inset
    x, y = config.room.width / 2 - inset, config.room.depth / 2 - inset
    return (Place(0.0, y, 0.0), Place(-x, 0.0, 90.0), Place(x, -config.room.depth / 4, 90.0), Place(0.0, -y, 0.0))


def _hang_anywhere(config: RoomConfig, panels: Panels, name: str, plan: Floorplan, doors: DoorPlan,
                   others: list[Target], rng: np.random.Generator) -> Target:
    """Hang a panel on a random wall without overlap, in an open room, off the exit unless that is the whole floor."""
    faces = [f for f in plan.faces if f.length >= panels.width]
    if not faces:
        raise Rejected(f"{name} must fit onto a wall")
    room = np.array([f.length - panels.width + 1e-3 for f in faces])
    inset = panels.thickness / 2 if panels.inset is None else panels.inset
    is_everywhere = is_whole_floor(config, plan.exit)
    for _ in range(200):
        face: Face = faces[int(rng.choice(len(faces), p=room / room.sum()))]
        along = panels.width / 2 + float(rng.uniform(0.0, face.length - panels.width))
        z = panels.centre_height + float(rng.uniform(-panels.height_spread, panels.height_spread))
        cos, sin = round(math.cos(face.yaw), 15), round(math.sin(face.yaw), 15)
        target = _make_target(name, panels, face.x + cos * along - sin * inset, face.y + sin * along + cos * inset,
                              max(z, panels.height / 2), face.yaw)
        radius = math.hypot(target.half_x, target.half_y)
        crowded = any(math.hypot(target.x - o.x, target.y - o.y) < radius + math.hypot(o.half_x, o.half_y) + panels.gap
                      for o in others)
        exit_x, exit_y = plan.exit.centre
        area = make_footprint(exit_x, exit_y, plan.exit.x_max - exit_x, plan.exit.y_max - exit_y)
        is_outside = is_everywhere or compute_distance(target.x, target.y, area) > radius
        if not crowded and is_outside and doors.allows(target):
            return target
    raise Rejected(f"{len(others) + 1} buttons must fit onto the walls without overlap, outside the exit")


def _lay_pads(config: RoomConfig, names: tuple[str, ...], plan: Floorplan, doors: DoorPlan,
              panels: tuple[Target, ...], rng: np.random.Generator) -> list[Target]:
    """Place pads where the body fits all over them, off other targets, off the exit unless that is the whole floor."""
    pads = config.puzzle.pads
    if pads is None:
        raise ConfigError("puzzle.pads", None, f"sizes and places of the pads {', '.join(names)}")
    if not isinstance(pads.places, str):
        return [_make_pad(pads, name, place.x, place.y, math.radians(place.yaw_deg))
                for name, place in zip(names, pads.places, strict=False)]
    half_x, half_y = config.room.width / 2, config.room.depth / 2
    walls = stack_footprints([solid.footprint for solid in plan.solids])
    radius, body = math.hypot(pads.width, pads.depth) / 2, config.robot.inner_radius + PASSAGE_SLACK
    area = plan.exit
    is_everywhere = is_whole_floor(config, area)
    laid: list[Target] = []
    for name in names:
        for _ in range(300):
            x, y = float(rng.uniform(-half_x, half_x)), float(rng.uniform(-half_y, half_y))
            exit_x, exit_y = max(area.x_min - x, x - area.x_max), max(area.y_min - y, y - area.y_max)
            if (compute_distance_many(np.array([[x, y]]), walls)[0] >= radius + body
                    and all(compute_distance(x, y, other.footprint) >= radius + body for other in (*panels, *laid))
                    and (is_everywhere or max(exit_x, exit_y) >= radius)
                    and doors.allows(pad := _make_pad(pads, name, x, y, 0.0))):
                laid.append(pad)
                break
        else:
            raise Rejected(f"{name} must fit onto the floor")
    return laid


def _make_pad(pads: Pads, name: str, x: float, y: float, yaw: float) -> Target:
    return Target(name, x, y, _PAD_HEIGHT, pads.width / 2, pads.depth / 2, _PAD_HEIGHT, yaw, "pad")


def _place_start(config: RoomConfig, instance: RoomInstance, space: FreeSpace, doors: DoorPlan,
                 rng: np.random.Generator) -> RoomInstance:
    if config.start.place == "fixed" or get_mixin(instance.puzzle, Mapped).map_rows:
        return instance
    if config.start.place == "cells":
        return dataclasses.replace(instance, starts=_list_cell_starts(config, instance, space, doors))
    labels, counts = np.unique(space.labels[space.labels > 0], return_counts=True)
    if not len(labels):
        raise Rejected("the body must fit somewhere")
    centres = space.grid.get_centres(space.get_cells(int(labels[counts.argmax()])))
    centres = centres[doors.is_at_start(centres)]
    if not len(centres):
        raise Rejected("the body must fit into the room of the starts")
    area, (x, y) = instance.exit, np.ascontiguousarray(centres.T)
    outside = ~((x >= area.x_min) & (x <= area.x_max) & (y >= area.y_min) & (y <= area.y_max))
    away, apart = np.ones(len(centres), dtype=bool), instance.robot.outer_radius + instance.dynamics.press_margin
    for target in instance.targets:
        around = math.hypot(target.half_x, target.half_y) + apart
        near = np.flatnonzero((np.abs(x - target.x) <= around) & (np.abs(y - target.y) <= around))
        away[near] &= compute_distance_many(centres[near], stack_footprints([target.footprint])) > apart
    space.work.spend(len(centres) / 30 * (1 + len(instance.targets) / 4))
    centres = next(centres[allowed] for allowed in (outside & away, away, np.ones_like(away)) if allowed.any())
    turns = round(360 / instance.robot.turn_step_deg)
    space.work.spend(15 * config.start.choices)
    starts = [
        Start(float(x), float(y), int(rng.integers(turns)))
        for x, y in centres[rng.integers(len(centres), size=config.start.choices)]
    ]
    solids = [solid.footprint for solid in instance.all_solids]
    for number in range(len(starts)):
        for _ in range(_START_TRIES):
            if has_arm_free(instance, starts[number]) and does_base_fit(instance.robot, starts[number], solids):
                break
            x, y = centres[rng.integers(len(centres))].tolist()
            starts[number] = Start(x, y, int(rng.integers(turns)))
    return dataclasses.replace(instance, starts=tuple(starts))


def _list_cell_starts(config: RoomConfig, instance: RoomInstance, space: FreeSpace, doors: DoorPlan
                      ) -> tuple[Start, ...]:
    """Starts at the centre of each free cell, row by row from the top, off the exit unless it is the whole floor."""
    cell, area = config.room.cell, instance.exit
    columns, rows = round(config.room.width / cell), round(config.room.depth / cell)
    centres = np.array([compute_cell(config, number) for number in range(rows * columns)])
    heading = _fixed_start(config, instance.puzzle)
    solids = [solid.footprint for solid in instance.solids]
    free = [place for place in centres[space.is_clear(centres) & doors.is_at_start(centres)].tolist()
            if does_base_fit(instance.robot, dataclasses.replace(heading, x=place[0], y=place[1]), solids)]
    outside = [place for place in free if not area.contains(*place)]
    starts = tuple(dataclasses.replace(heading, x=x, y=y) for x, y in outside or free)
    if not starts:
        raise Rejected("the body must fit into a cell")
    return starts


def _place_props(instance: RoomInstance, rng: np.random.Generator) -> RoomInstance:
    """Place props on the floor; blocks get enough free floor behind them for a push."""
    if not instance.props:
        return instance
    taken = [(s.x, s.y, instance.robot.outer_radius) for s in instance.starts[:1]]
    walls = stack_footprints([solid.footprint for solid in instance.solids])
    placed = []
    for entry in instance.props:
        size = entry.prop.half_size * math.sqrt(2)
        need = size + (2.2 * instance.robot.outer_radius + 0.3 if entry.prop.kind == "block" else 0.3)
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


def _place_obstacles(config: RoomConfig, instance: RoomInstance, floors: Floors,
                    rng: np.random.Generator) -> tuple[RoomInstance, Floors]:
    """Add obstacles in batches. A batch that breaks the certificate is halved; a single obstacle is drawn again."""
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
            continue  # obstacles may touch, but none may be inside another or a wall
        return Solid("cylinder" if is_cylinder else "box", x, y, half_x, half_y, yaw, settings.height, "obstacle")
    raise Rejected("obstacles must fit clear of the start, buttons, props and exit")


# --- doors between rooms --------------------------------------------------------------------


class DoorPlan(NamedTuple):
    """Doors of a floor plan."""

    solids: tuple[Solid, ...] = ()  # doors, in the puzzle's order
    rooms: tuple[Rectangle, ...] = ()  # rooms of the floor; a single one without doors
    ways: tuple[tuple[int, ...], ...] = ()  # indices of the doors on the way from the starts to each room
    opened: Mapping[str, frozenset[int]] = MappingProxyType({})
    """Target name -> doors that are open by the time it is needed; targets without an entry are not needed."""

    def allows(self, target: Target) -> bool:
        """Return whether a target is in one room that is open when the target is needed."""
        if not self.solids:
            return True
        room = self._find_room(target)
        needed = self.opened.get(target.name)
        return room is not None and (needed is None or needed.issuperset(self.ways[room]))

    def _find_room(self, target: Target) -> int | None:
        """Index of the room that contains a target's whole outline; panels hang slightly in front of their wall."""
        shape = target.footprint
        places = [(shape.x + share * shape.cos * shape.half_x, shape.y + share * shape.sin * shape.half_x)
                  for share in (-1, 1)]
        return next((number for number, room in enumerate(self.rooms)
                     if all(room.contains(x, y) for x, y in places)), None)

    def list_ways(self, targets: Sequence[Target], exit_: Rectangle, body_radius: float) -> tuple[tuple[int, ...], ...]:
        """Return the doors on the way to each target and, last, to the exit, as in `RoomInstance.ways`.

        Raises:
            Rejected: a target or the exit is not in exactly one room.
        """
        if not self.solids:
            return ()
        ways = []
        for target in targets:
            room = self._find_room(target)
            if room is None or not self.allows(target):
                raise Rejected(f"{target.name} must be in one room, which is open when it is needed")
            ways.append(self.ways[room])
        return (*ways, self._find_way_out(exit_, body_radius))

    def _find_way_out(self, exit_: Rectangle, body_radius: float) -> tuple[int, ...]:
        """Doors on the way to the room of the exit, or to the room next to an exit in an outer wall."""
        rooms = [number for number, room in enumerate(self.rooms) if _overlaps(room, exit_, body_radius + CONTACT_SKIN)]
        if not rooms:  # the exit is an alcove
            x, y = exit_.centre
            low_x, high_x = min(r.x_min for r in self.rooms), max(r.x_max for r in self.rooms)
            low_y, high_y = min(r.y_min for r in self.rooms), max(r.y_max for r in self.rooms)
            x, y = min(max(x, low_x), high_x), min(max(y, low_y), high_y)
            rooms = [number for number, room in enumerate(self.rooms) if room.contains(x, y)]
        ways = sorted((self.ways[room] for room in rooms), key=len)
        if not ways or any(not set(ways[0]) <= set(way) for way in ways):
            raise Rejected("the exit must be in one room")
        return ways[0]

    def is_at_start(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether places (n, 2) are reachable from the starts without a door."""
        if not self.solids:
            return np.ones(len(places), dtype=bool)
        found = np.zeros(len(places), dtype=bool)
        x, y = places.T
        for room, way in zip(self.rooms, self.ways, strict=True):
            if not way:
                found |= (x >= room.x_min) & (x <= room.x_max) & (y >= room.y_min) & (y <= room.y_max)
        return found


def _overlaps(room: Rectangle, area: Rectangle, margin: float) -> bool:
    """Return whether an area overlaps a room by more than a margin at its sides."""
    return (max(room.x_min + margin, area.x_min) <= min(room.x_max - margin, area.x_max)
            and max(room.y_min + margin, area.y_min) <= min(room.y_max - margin, area.y_max))


def sample_doors(config: RoomConfig, puzzle: Puzzle, plan: Floorplan, rng: np.random.Generator) -> DoorPlan:
    """Place a puzzle's doors in doorways of a floor plan.

    Raises:
        ConfigError: there are fewer doorways than doors, or the puzzle cannot open all doors.
        Rejected: the fixed start is in no room.
    """
    count = len(get_mixin(puzzle, Doored).door_facts)
    if not count:
        return DoorPlan()
    if config.room.rooms <= count:
        raise ConfigError("room.rooms", config.room.rooms, f"more than {count}: the puzzle needs one doorway for each "
                          "of its doors")
    order, opened = _draw_order(puzzle, rng)
    first = int(rng.integers(len(plan.rooms)))
    if config.start.place == "fixed":
        first = next((number for number, room in enumerate(plan.rooms)
                      if room.contains(config.start.x, config.start.y)), -1)
        if first < 0:
            raise Rejected("the fixed start must be in a room")
    with_doors = set(rng.choice(len(plan.doorways), count, replace=False).tolist())
    ways: dict[int, tuple[int, ...]] = {first: ()}
    solids: dict[int, Solid] = {}
    for door in (*order, None):
        while True:
            open_ways = [(at, to) for number, way in enumerate(plan.doorways) if number not in with_doors
                         for at, to in itertools.permutations(way.rooms) if at in ways and to not in ways]
            if not open_ways:
                break
            for at, to in open_ways:
                ways[to] = ways[at]
        if door is None:
            break
        shut = [(number, at, to) for number in sorted(with_doors)
                for at, to in itertools.permutations(plan.doorways[number].rooms) if at in ways and to not in ways]
        number, at, to = shut[int(rng.integers(len(shut)))]
        ways[to] = tuple(sorted((*ways[at], door)))
        solids[door] = plan.doorways[number].door
    return DoorPlan(tuple(solids[door] for door in range(count)), plan.rooms,
                    tuple(ways[room] for room in range(len(plan.rooms))), opened)


def _draw_order(puzzle: Puzzle, rng: np.random.Generator) -> tuple[list[int], dict[str, frozenset[int]]]:
    """Draw an order of opening the doors by operators. Returns it and the doors open when each target is first used.

    Raises:
        ConfigError: operators cannot open all doors.
    """
    model, facts = puzzle.symbolic.make_symbolic_model(), puzzle.symbolic.get_facts(puzzle.make_state())
    doors = get_mixin(puzzle, Doored).door_facts
    opened: dict[str, frozenset[int]] = {}
    order: list[int] = []
    while True:
        order += [door for door, fact in enumerate(doors) if fact in facts and door not in order]
        able = [op for op in model.operators if op.relax(facts) - facts]
        if not able:
            break
        chosen = able[int(rng.integers(len(able)))]
        opened.setdefault(chosen.target, frozenset(order))
        facts |= chosen.relax(facts)
    if len(order) < len(doors):
        raise ConfigError("puzzle.door_facts", doors, "facts that the puzzle's operators can all make true")
    return order, opened
