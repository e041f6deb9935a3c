"""`objects`: one row of numbers per object, in arbitrary order, and the joints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.observations.base import BatchView, Observer, register_observation
from hrl_escape.env.poses import get_planar_pose
from hrl_escape.env.puzzles.cues import CUE_WORDS, make_cue_rows
from hrl_escape.env.puzzles.mixins import Cued, get_mixin

if TYPE_CHECKING:
    from torch import Tensor

OBJECT_WORDS = ("present", "target", "block", "plate", "exit", "ahead", "left", "sin", "cos", "half-x", "half-y",
                "lit")
"""Names of the numbers in a row of `objects`."""


class ObjectObserver(Observer):
    """One row of numbers per object, and the joints; all in [-1, 1].

    Targets, blocks, plates and the exit have rows. A row has 1 if the object is present (rows of targets that this
    instance lacks are 0: the mask), its type, its position ahead and to the left of the robot, sine and cosine of its
    direction relative to the robot, half its sizes, and 1 if it is lit, or the exit open. Lengths are fractions of the
    floor's diagonal. If targets have cues, every row continues with `CUE_WORDS`: 1 for the colour, the shape and the
    size of the target's cue. The order of rows carries no information. Joint angles as fractions of their limits
    follow.
    """

    name = "objects"
    doc = "one row per target, block, plate and exit: type, pose relative to the robot, size, lit"

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance, frame = self._instance, self._frame
        props, exit_ = instance.props, instance.exit
        self.rows = rows = (*frame.target_names, *(placed.prop.name for placed in props), "exit")
        cues = make_cue_rows(get_mixin(instance.puzzle, Cued).cues)
        self.words = words = OBJECT_WORDS + CUE_WORDS[: cues.shape[1]]
        self.names = (*(f"{row}-{word}" for row in rows for word in words), *self._joint_names)
        self._diagonal = 2 * math.hypot(frame.reach_x, frame.reach_y)
        things = [(t.x, t.y, t.yaw, t.half_x, t.half_y, "target") for t in instance.targets]
        things += [(p.x, p.y, p.yaw, p.prop.half_size, p.prop.half_size, p.prop.kind) for p in props]
        things += [(*exit_.centre, 0.0, (exit_.x_max - exit_.x_min) / 2, (exit_.y_max - exit_.y_min) / 2, "exit")]
        self._poses = np.array([thing[:3] for thing in things], dtype=np.float64)
        self._targets, absent = len(instance.targets), len(frame.target_names) - len(instance.targets)
        self._props = slice(self._targets, self._targets + len(props))
        self._places = [*range(self._targets), *range(self._targets + absent, len(rows))]
        self._rows = np.zeros((len(rows), len(words)))
        self._rows[: len(cues), len(OBJECT_WORDS):] = cues
        for place, (_, _, _, half_x, half_y, kind) in zip(self._places, things, strict=True):
            self._rows[place, [0, OBJECT_WORDS.index(kind)]] = 1.0
            self._rows[place, 9:11] = half_x / self._diagonal, half_y / self._diagonal
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a new float32 array with one entry per name."""
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        poses, rows = self._poses.copy(), self._rows.copy()
        if state.physics is not None and self._props.stop > self._props.start:
            poses[self._props] = [get_planar_pose(numbers) for numbers in state.physics.props]
        away_x, away_y = (poses[:, 0] - state.x) / self._diagonal, (poses[:, 1] - state.y) / self._diagonal
        thing_cos, thing_sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        rows[self._places, 5:9] = np.stack([
            cos * away_x + sin * away_y, cos * away_y - sin * away_x,
            thing_sin * cos - thing_cos * sin, thing_cos * cos + thing_sin * sin], axis=1)
        rows[: self._targets, 11] = self._puzzle.get_lit(state.puzzle)
        rows[-1, 11] = self._puzzle.is_solved(state.puzzle)
        joints = np.array(self._rules.get_angles(state)) / self._joint_limits if self._joint_limits else ()
        return np.clip(np.concatenate([rows.ravel(), joints]), -1.0, 1.0).astype(np.float32)

    @staticmethod
    def observe_batch(rooms: BatchView) -> list[Tensor]:
        """Return parts of the vector, float32 (numbers, rooms) each."""
        import torch

        targets, (half_x, half_y), (x_min, x_max, y_min, y_max) = rooms.targets, rooms.half_sizes, rooms.exit
        diagonal = 2 * torch.sqrt(half_x * half_x + half_y * half_y).to(torch.float64)
        cos, sin = rooms.rotation

        def make_rows(kind: str, x: Tensor, y: Tensor, thing_cos: Tensor, thing_sin: Tensor, width: Tensor,
                      depth: Tensor, lit: Tensor) -> Tensor:
            away_x, away_y = (x - rooms.x) / diagonal, (y - rooms.y) / diagonal
            one = torch.ones_like(away_x)
            numbers = {
                "present": one, kind: one, "ahead": cos * away_x + sin * away_y, "left": cos * away_y - sin * away_x,
                "sin": thing_sin * cos - thing_cos * sin, "cos": thing_cos * cos + thing_sin * sin,
                "half-x": width / diagonal * one, "half-y": depth / diagonal * one, "lit": lit * one,
            }
            rows = torch.stack([numbers.get(word, torch.zeros_like(one)) for word in OBJECT_WORDS], dim=1)
            return rows.to(torch.float32)  # (objects, words, rooms)

        rows = make_rows("target", targets.x, targets.y, targets.cos, targets.sin, targets.half_x, targets.half_y,
                         rooms.lit.to(torch.float64))
        rows = torch.cat([rows, rooms.cues.expand(-1, -1, len(rooms.x))], dim=1)
        rows = torch.where(rooms.is_present.unsqueeze(1), rows, 0.0)
        nought, is_open = torch.zeros_like(rooms.x), rooms.is_solved.to(torch.float64)
        exit_ = [((x_min + x_max) / 2, (y_min + y_max) / 2), (nought + 1.0, nought), ((x_max - x_min) / 2,
                 (y_max - y_min) / 2), (is_open,)]
        way_out = make_rows("exit", *(part.unsqueeze(0) for pair in exit_ for part in pair))
        way_out = torch.cat([way_out, torch.zeros_like(rows[:1, len(OBJECT_WORDS):])], dim=1)
        limits = torch.tensor([max(abs(low), abs(high)) for low, high in rooms.limits], device=nought.device)
        joints = rooms.angles.to(torch.float32) / limits.unsqueeze(1)
        return [part.clamp(-1.0, 1.0) for part in (rows.flatten(0, 1), way_out.flatten(0, 1), joints)]


register_observation(ObjectObserver)
