"""Room instances as tables of tensors for the batched engine, padded to one shape.

`Layout` has the constants of a compiled kernel, `Tables` the numbers of every instance in the given order. This module
contains no dynamics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorPuzzle, as_signed, get_tensor_puzzle
from hrl_escape.env.config import DynamicsConfig, RobotConfig
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.primitives import ActionTable
from hrl_escape.env.puzzles.cues import make_cue_rows
from hrl_escape.env.puzzles.mixins import Cued, Mapped, Pushing, get_mixin
from hrl_escape.env.rewards import RewardConfig
from hrl_escape.env.robot import Robot, make_robot
from hrl_escape.env.sight import list_hiders
from hrl_escape.env.tensor_geometry import Shapes, SplitShapes, stack_shapes
from hrl_escape.env.velocities import Velocities
from hrl_escape.errors import UnsupportedError

INSTEAD = "use the Bullet engine: gymnasium.make(...), or make_vec(..., vectorization_mode='sync')"


@dataclasses.dataclass(frozen=True)
class Layout:
    """Properties that all rooms of a batch share. One compiled kernel serves all batches with equal layouts."""

    robot: RobotConfig  # robot section of the room configuration
    actions: ActionTable  # action table of the robot
    dynamics: DynamicsConfig  # noise, slips, and the part of the robot that presses
    puzzle: str  # kind of the puzzle
    targets: int  # largest number of targets of an instance
    has_door: bool  # whether any exit has a door
    inner_doors: int  # largest number of inner doors of an instance
    has_cells: bool  # whether targets are cells of a map
    has_offsets: bool  # whether headings can leave the lattice of turn steps (noise, velocities, or a start off it)
    is_shared: bool  # whether there is a single instance, which makes look-ups unnecessary
    is_watching: bool  # whether puzzles are updated after every primitive
    can_push: bool  # whether moves push things
    is_puzzle_random: bool  # whether the puzzle of any room is random
    draws: bool  # whether anything is random in an episode
    resample: bool  # whether a new episode draws another instance
    velocities: Velocities | None = None  # bounds and time step of velocities as actions, or None for primitives
    reward: RewardConfig | None = None  # reward if it pays more than steps and exits, the same for all rooms

    @property
    def arm(self) -> Robot:
        """The robot with its chain of joints."""
        return make_robot(self.robot)

    @property
    def headings(self) -> int:
        """Number of turn steps in a full turn."""
        return round(360 / self.robot.turn_step_deg)

    @property
    def has_joint_offsets(self) -> bool:
        """True if joints can leave the lattice of joint steps, through noise or velocities."""
        return bool(self.dynamics.noise) or self.velocities is not None


class Tables(NamedTuple):
    """Numbers of every instance; the last axis of each table is the instance."""

    solids: Shapes  # walls and obstacles, (solids, instances)
    split_solids: SplitShapes  # the same in single precision
    hiders: Shapes  # the solids that can hide one place on the floor from another
    doors: Shapes  # exit doors, (1, instances), out of the way if there is none
    inner_doors: Shapes  # (inner doors, instances), out of the way if absent
    inner_leaves: Tensor
    """True for doors, which hide things behind them, false for things in cells, bool (inner doors, instances)."""
    ways: Tensor
    """Bits of the inner doors on the way to each target and, last, to the exit, int64 (targets + 1, instances)."""
    target_counts: Tensor
    """Number of targets of each instance, int64 (1, instances); other targets in its columns are out of reach."""
    targets: Shapes  # outlines of targets, (targets, instances)
    round_targets: Shapes  # the same in single precision, around their exact centres
    target_z: Tensor  # height of the targets' centres, m, float32
    target_half_z: Tensor  # half the targets' height, m, float32
    target_reach: Tensor
    """Largest floor distance of the body's axis that touches a target, m, float32; -1 for never."""
    target_margin: Tensor  # the same from a rectangular base's outline, or its axis for a pad, m; -1 for never
    is_panel: Tensor  # true for panels, false for pads, bool
    cues: Tensor  # numbers of the targets' cues, float32 (targets, `CUE_WORDS`, instances), of width 0 without cues
    exits: Tensor  # x_min, x_max, y_min, y_max, (4, instances)
    half_sizes: Tensor  # largest |x| and |y| of the floor in the frame of observations, (2, instances)
    rewards: Tensor  # reward of a primitive or a step of velocities, and of one that exits, (2, instances)
    horizons: Tensor  # number of primitives or steps before truncation, int32 (1, instances)
    starts: Tensor  # x, y, heading offset, (3, starts, instances)
    start_headings: Tensor  # turn steps, int32 (starts, instances)
    start_touching: Tensor  # bits of the targets touched at each start, int64 (starts, instances)
    start_counts: Tensor  # number of starts of each instance, int64 (1, instances)
    puzzle: dict[str, Tensor]  # tables of the puzzle, (..., instances) except for shared ones
    puzzle_starts: Tensor  # initial states of the puzzle, int64 (puzzle starts, instances)
    puzzle_start_counts: Tensor  # number of initial states of each instance, int64 (1, instances)
    headings: Tensor  # angle, cosine and sine of each turn step, (3, headings)
    total: Tensor  # number of instances, int64 ()


def map_tensors(function: Callable[[Tensor], Any], tree: Any) -> Any:
    """Apply a function to every tensor in nested tuples and dicts; None stays None."""
    if isinstance(tree, Tensor):
        return function(tree)
    if tree is None:
        return None
    if isinstance(tree, dict):
        return {key: map_tensors(function, value) for key, value in tree.items()}
    parts = [map_tensors(function, value) for value in tree]
    return tuple(parts) if type(tree) is tuple else type(tree)(*parts)


def list_tensors(tree: Any, into: list[Tensor] | None = None) -> list[Tensor]:
    """List all tensors in nested tuples and dicts, in order; append to `into` if given."""
    found: list[Tensor] = [] if into is None else into
    if isinstance(tree, Tensor):
        found.append(tree)
    elif tree is not None:
        for part in tree.values() if isinstance(tree, dict) else tree:
            list_tensors(part, found)
    return found


def pick(layout: Layout, table: Any, instance: Tensor) -> Any:
    """Return each room's column of tables: (..., instances) gives (..., rooms), or (..., 1) if all rooms share one."""
    return table if layout.is_shared else map_tensors(lambda column: column[..., instance], table)


def pick_column(layout: Layout, instance: Tensor) -> Tensor:
    """Return the index of each room's column in tables, int64 (rooms,): its instance, or 0 if all rooms share one."""
    return torch.zeros_like(instance) if layout.is_shared else instance


def pick_rules(layout: Layout, tables: Tables, instance: Tensor) -> tuple[TensorPuzzle, PuzzleTables]:
    """Return the puzzle's rules, and each room's columns of their tables."""
    form = get_tensor_puzzle(layout.puzzle)
    return form, {name: table if name in form.whole else pick(layout, table, instance)
                  for name, table in tables.puzzle.items()}


def make_layout(instances: Sequence[RoomInstance], resample: bool, velocities: Velocities | None = None) -> Layout:
    """Derive the layout that instances share.

    Raises:
        UnsupportedError: physics dynamics, or instances that differ in robot, dynamics, additional rewards, or kind or
            size of puzzle.
    """
    first = instances[0]
    if first.dynamics.kind != "kinematic":
        raise UnsupportedError(f"the batched engine steps kinematic rooms, not dynamics.kind = "
                               f"{first.dynamics.kind!r}: {INSTEAD}")
    for index, other in enumerate(instances):
        for what, mine, theirs in (("robot", first.robot, other.robot), ("dynamics", first.dynamics, other.dynamics),
                                   ("kind of puzzle", first.puzzle.kind, other.puzzle.kind),
                                   ("number of targets", len(first.frame.target_names),
                                    len(other.frame.target_names)),
                                   ("reward", *(None if one.reward.is_sparse else one.reward
                                                for one in (first, other))),
                                   ("cues on targets", *(bool(get_mixin(one.puzzle, Cued).cues)
                                                          for one in (first, other)))):
            if mine != theirs:
                raise UnsupportedError(f"instance {index} of a batch differs from instance 0 in {what} ({theirs} "
                                   f"and not {mine}). Make one batch for each")
    noise = first.dynamics.noise
    is_puzzle_random = any(instance.puzzle.is_random for instance in instances)
    return Layout(
        robot=first.robot,
        actions=first.robot.actions,
        dynamics=first.dynamics,
        puzzle=first.puzzle.kind,
        targets=len(first.frame.target_names),
        has_door=any(instance.door for instance in instances),
        inner_doors=max(len(instance.inner_doors) for instance in instances),
        has_cells=isinstance(first.puzzle, Mapped),
        has_offsets=(bool(noise) or velocities is not None
                     or any(start.heading_offset for instance in instances for start in instance.starts)),
        is_shared=len(instances) == 1,
        is_watching=first.puzzle.is_watching,
        can_push=isinstance(first.puzzle, Pushing),
        is_puzzle_random=is_puzzle_random,
        draws=(resample or is_puzzle_random or bool(noise or first.dynamics.slip)
               or any(len(i.starts) > 1 or len(i.puzzle.list_starts()) > 1 for i in instances)),
        resample=resample,
        velocities=velocities,
        reward=None if first.reward.is_sparse else first.reward,
    )


def stack_instances(instances: Sequence[RoomInstance], layout: Layout, device: torch.device) -> Tables:
    """Stack instances into tables on a device.

    Raises:
        UnsupportedError: the puzzle has neither a tensor form nor a table.
    """

    def floats(values: Any, dtype: torch.dtype = torch.float64) -> Tensor:
        return torch.as_tensor(np.asarray(values, dtype=np.float64)).to(device, dtype)

    def integers(values: Any, dtype: torch.dtype = torch.int64) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    def shapes(rows: Sequence[Any], least: int = 1) -> Shapes:
        return Shapes(*floats(stack_shapes(rows, least)))

    def columns(rows: Sequence[Sequence[float]]) -> np.ndarray:
        return np.array(rows, dtype=np.float64).T

    kind = layout.velocities
    surplus = [kind.compute_surplus(i) if kind else 0.0 for i in instances]
    rules = [Rules(instance) for instance in instances]
    solids = shapes([[solid.footprint for solid in i.solids] for i in instances])
    targets = shapes([[target.footprint for target in i.targets] for i in instances], layout.targets)
    most = max(len(instance.starts) for instance in instances)
    begins = [[rule.make_state(start) for start in (*i.starts, *(i.starts[-1],) * (most - len(i.starts)))]
              for rule, i in zip(rules, instances, strict=True)]  # (instances, starts)
    turns = [(rules[0].get_heading(rules[0].make_state(Start(heading_steps=n))), *rules[0].get_rotation(n, 0.0))
             for n in range(layout.headings)]
    form = get_tensor_puzzle(layout.puzzle)
    widest = max((i.frame for i in instances), key=lambda frame: len(frame.bounds))
    puzzle = form.make_tables([i.puzzle for i in instances], widest)
    puzzle_starts = [[as_signed(form.encode(i.puzzle, state)) for state in i.puzzle.list_starts()] for i in instances]
    most_puzzle = max(map(len, puzzle_starts))

    def pad(values: Sequence[float]) -> list[float]:
        return [*values, *[-1.0] * (layout.targets - len(values))]

    return Tables(
        solids=solids,
        split_solids=solids.split(),
        hiders=shapes([list_hiders(i) for i in instances]),
        doors=shapes([[i.door.footprint] if i.door else [] for i in instances]),
        inner_doors=shapes([[door.footprint for door in i.inner_doors] for i in instances]),
        inner_leaves=integers([[len(i.inner_doors) > number and i.inner_doors[number].role == "door" for i in instances]
                               for number in range(max(1, layout.inner_doors))], torch.bool),
        ways=integers(columns([list_ways(i, layout.targets) for i in instances])),
        target_counts=integers([[len(i.targets) for i in instances]]),
        targets=targets,
        round_targets=targets.round(),
        target_z=floats(columns([pad([t.z for t in i.targets]) for i in instances]), torch.float32),
        target_half_z=floats(columns([pad([t.half_z for t in i.targets]) for i in instances]), torch.float32),
        target_reach=floats(columns([pad([i.compute_press_reach(t) for t in i.targets]) for i in instances]),
                            torch.float32),
        target_margin=floats(columns([pad([i.compute_press_margin(t) for t in i.targets]) for i in instances])),
        is_panel=floats(columns([pad([t.kind == "panel" for t in i.targets]) for i in instances])) > 0.5,
        cues=floats(_stack_cues(instances, layout.targets), torch.float32),
        exits=floats(columns([(i.exit.x_min, i.exit.x_max, i.exit.y_min, i.exit.y_max) for i in instances])),
        half_sizes=floats(columns([(i.frame.reach_x, i.frame.reach_y) for i in instances]), torch.float32),
        rewards=floats(columns([(i.reward.step - more, i.reward.on_exit - more)
                                for i, more in zip(instances, surplus, strict=True)]), torch.float32),
        horizons=integers([[kind.count_steps(i.horizon) if kind else i.horizon for i in instances]], torch.int32),
        starts=floats([[[getattr(row[k], name) for row in begins] for k in range(most)]
                       for name in ("x", "y", "heading_offset")]),
        start_headings=integers([[row[k].heading_steps for row in begins] for k in range(most)], torch.int32),
        start_touching=integers([[as_signed(row[k].touching) for row in begins] for k in range(most)]),
        start_counts=integers([[len(i.starts) for i in instances]]),
        puzzle={name: torch.as_tensor(values).to(device) for name, values in puzzle.items()},
        puzzle_starts=integers([[row[min(k, len(row) - 1)] for row in puzzle_starts] for k in range(most_puzzle)]),
        puzzle_start_counts=integers([[len(row) for row in puzzle_starts]]),
        headings=floats(columns(turns)),
        total=integers(len(instances)),
    )


def list_ways(instance: RoomInstance, targets: int) -> list[int]:
    """Return the bits of the inner doors on the way to each target, 0 for absent targets, and last to the exit."""
    ways = [sum(1 << door for door in way) for way in instance.ways] or [0]
    return [*ways[:-1], *[0] * (targets + 1 - len(ways)), ways[-1]]


def _stack_cues(instances: Sequence[RoomInstance], targets: int) -> np.ndarray:
    """Cues of every instance, 0 for absent targets, (targets, `CUE_WORDS`, instances)."""
    rows = [make_cue_rows(get_mixin(instance.puzzle, Cued).cues) for instance in instances]
    return np.stack([np.pad(row, ((0, targets - len(row)), (0, 0))) for row in rows], axis=-1)
