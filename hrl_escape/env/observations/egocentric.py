"""`egocentric`: the view from the robot's place, its joints, and a ring of lidar."""

from __future__ import annotations

import math
import operator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.observations.base import BatchView, Observer, clip, register_observation
from hrl_escape.env.puzzles.cues import CUE_WORDS, make_cue_rows
from hrl_escape.env.puzzles.mixins import Cued, Mapped, get_mixin
from hrl_escape.env.sight import SIGHT_SLACK, Scanner, list_hiders

if TYPE_CHECKING:
    from torch import Tensor

LIDAR_RAYS = 16


class EgocentricObserver(Observer):
    """Ranges and bearings from the robot's place, its joints, and a ring of lidar, all in [-1, 1].

    Each target has its range as a fraction of the room's diagonal, sine and cosine of its bearing, 1 if it is lit, and
    `CUE_WORDS` if targets have cues. Each block, each plate and the exit has range, sine and cosine. Numbers of
    things that are hidden, or absent from this instance, are 0. Joint angles as fractions of their limits follow, then
    lidar ranges as fractions of the diagonal, counter-clockwise from straight ahead.

    Walls, obstacles and shut doors hide things and stop rays.
    """

    name = "egocentric"
    doc = "range and bearing of things in sight, joints, and a ring of lidar"

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance, frame = self._instance, self._frame
        self._cues = make_cue_rows(get_mixin(instance.puzzle, Cued).cues).tolist()
        words = ("range", "sin", "cos", "lit", *(CUE_WORDS if self._cues else ()))
        per_target = tuple(f"{name}-{word}" for name in frame.target_names for word in words)
        things = (*(placed.prop.name for placed in instance.props), "exit")
        per_thing = tuple(f"{name}-{word}" for name in things for word in ("range", "sin", "cos"))
        self.names = (*per_target, *per_thing, *self._joint_names, *(f"lidar-{i}" for i in range(LIDAR_RAYS)))
        self._diagonal = 2 * math.hypot(frame.reach_x, frame.reach_y)
        self._fixed = [(t.x, t.y) for t in instance.targets]
        self._standing = [(placed.x, placed.y) for placed in instance.props]
        are_cells = isinstance(instance.puzzle, Mapped)
        half = [math.hypot(t.half_x, t.half_y) if are_cells else t.half_y for t in instance.targets]
        self._slack = SIGHT_SLACK + np.array([
            *half, *(placed.prop.half_size for placed in instance.props), 0.0])
        self._per_target = len(words)
        self._absent = [0.0] * (len(words) * (len(frame.target_names) - len(instance.targets)))
        self._bearings = np.arange(LIDAR_RAYS, dtype=np.float64) * (math.tau / LIDAR_RAYS)
        self._hiders, self._solids = list_hiders(instance), [solid.footprint for solid in instance.solids]
        leaves = (number for number, door in enumerate(instance.inner_doors) if door.role == "door")
        self._leaves = sum(1 << number for number in leaves)
        self._scanners: dict[tuple[bool, int], tuple[Scanner, Scanner | None]] = {}
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def _find_scanners(self, state: RoomState) -> tuple[Scanner, Scanner | None]:
        """Scanners for lidar and for lines of sight, among fixed solids and shut doors."""
        doors = self._rules.inner_doors
        inner = doors.get_shut(state.puzzle) & self._leaves if doors else 0
        key = (self._instance.door is not None and not self._puzzle.is_solved(state.puzzle), inner)
        found = self._scanners.get(key)
        if found is None:
            leaves = [door.footprint for number, door in enumerate(self._instance.inner_doors) if inner >> number & 1]
            if key[0] and self._instance.door is not None:
                leaves.append(self._instance.door.footprint)
            hiders = self._hiders + leaves
            found = Scanner(self._solids + leaves, self._bearings), Scanner(hiders, self._bearings) if hiders else None
            if len(self._scanners) > 64:
                self._scanners.clear()
            self._scanners[key] = found
        return found

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a new float32 array with one entry per name."""
        x, y, diagonal = state.x, state.y, self._diagonal
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        scanner, hiders = self._find_scanners(state)
        standing = self._standing
        if standing and state.physics is not None:
            standing = [(numbers[0], numbers[1]) for numbers in state.physics.props]
        points = [*self._fixed, *standing, self._instance.exit.centre]
        sights = hiders.see(x, y, np.array(points), self._slack).tolist() if hiders else [True] * len(points)
        lit = self._puzzle.get_lit(state.puzzle)
        numbers: list[float] = []
        for number, ((at_x, at_y), is_seen) in enumerate(zip(points, sights, strict=True)):
            is_target = number < len(lit)
            if is_seen:
                ahead, aside = at_x - x, at_y - y
                away = math.hypot(ahead, aside)
                if away:
                    ahead, aside = ahead / away, aside / away
                else:
                    ahead, aside = 1.0, 0.0  # a point at the robot's own place has the bearing of +x
                numbers += away / diagonal, aside * cos - ahead * sin, ahead * cos + aside * sin
                if is_target:
                    numbers += float(lit[number]), *(self._cues[number] if self._cues else ())
            else:
                numbers += (0.0,) * (self._per_target if is_target else 3)
            if number == len(lit) - 1:
                numbers += self._absent
        numbers += map(clip, map(operator.truediv, self._rules.get_angles(state), self._joint_limits))
        seen = np.empty(len(self.names), dtype=np.float32)
        seen[:-LIDAR_RAYS] = numbers
        key = state.heading_steps if state.heading_offset == 0.0 else None
        ranges = scanner.measure(x, y, cos, sin, key)
        seen[-LIDAR_RAYS:] = np.minimum(ranges / diagonal, 1.0)
        return seen

    @staticmethod
    def observe_batch(rooms: BatchView) -> list[Tensor]:
        """Return parts of the vector, float32 (numbers, rooms) each."""
        import torch

        x_min, x_max, y_min, y_max = rooms.exit
        half_x, half_y = rooms.half_sizes
        diagonal = 2 * torch.sqrt(half_x * half_x + half_y * half_y)
        cos, sin = rooms.rotation

        def look_at(x: Tensor, y: Tensor, slack: Tensor) -> tuple[Tensor, Tensor]:
            """Range, sine and cosine of the bearing of points, and whether they are in sight; each (points, rooms)."""
            away_x, away_y = x - rooms.x, y - rooms.y
            distance = torch.sqrt(away_x * away_x + away_y * away_y)
            is_here = distance == 0.0
            per_metre = 1.0 / torch.where(is_here, 1.0, distance)
            ahead, aside = torch.where(is_here, 1.0, away_x * per_metre), away_y * per_metre
            free = rooms.cast_rays(ahead.unsqueeze(1), aside.unsqueeze(1), "hiders")
            looks = torch.stack([distance / diagonal, aside * cos - ahead * sin, ahead * cos + aside * sin], dim=1)
            return looks.to(torch.float32), free >= distance - slack

        targets, lit = rooms.targets, rooms.lit.to(torch.float32)
        half = torch.hypot(targets.half_x, targets.half_y) if rooms.are_cells else targets.half_y
        looks, in_sight = look_at(targets.x, targets.y, SIGHT_SLACK + half)
        looks = torch.cat([looks, lit.unsqueeze(1), rooms.cues.expand(-1, -1, len(rooms.x))], dim=1)
        seen = torch.where((rooms.is_present & in_sight).unsqueeze(1), looks, 0.0)
        way_out, in_sight = look_at(((x_min + x_max) / 2).unsqueeze(0), ((y_min + y_max) / 2).unsqueeze(0),
                                    torch.full_like(half_x, SIGHT_SLACK, dtype=torch.float64))
        way_out = torch.where(in_sight, way_out[0], 0.0)
        limits = torch.tensor([max(abs(low), abs(high)) for low, high in rooms.limits], device=lit.device)
        joints = rooms.angles.to(torch.float32) / limits.unsqueeze(1)
        bearings = torch.arange(LIDAR_RAYS, dtype=torch.float64, device=lit.device) * (math.tau / LIDAR_RAYS)
        ray_cos, ray_sin = torch.cos(bearings)[:, None, None], torch.sin(bearings)[:, None, None]
        ray_x, ray_y = cos * ray_cos - sin * ray_sin, sin * ray_cos + cos * ray_sin  # (rays, 1, rooms)
        lidar = rooms.cast_rays(ray_x, ray_y, "solids").clamp(min=0.0).to(torch.float32) / diagonal
        return [part.clamp(-1.0, 1.0) for part in (seen.flatten(0, 1), way_out, joints, lidar)]


register_observation(EgocentricObserver)
