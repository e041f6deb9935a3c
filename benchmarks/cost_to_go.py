"""Primitives of batched options with their own cost-to-go and with the planners' fields.

    python -m benchmarks.cost_to_go --presets clutter ten-button --rooms 12

Options of a batch follow cost-to-go fields found by value iteration (`options/batched/value_iteration.py`). Planners
have fields of their own, by Dijkstra's search over whole cells (`floor/cost_to_go.py`). The benchmark gives the batch
the planners' fields instead, at their resolution and with cells halved, and compares the primitives of the same options
from the same starts. Rooms are pressed by a round body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.kernels import read_clock
from hrl_escape.options.batched import cost_to_go
from hrl_escape.options.batched.cost_to_go import OTHER_PRESS_COST, InstanceFields
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.batched.stepping import REACHED

MOST_STEPS = 2_000


def make_planner_fields(instance: RoomInstance, refinement: int) -> InstanceFields:
    """Fields of the planners for a room, in the form of a batch; each `refinement` halves the cells."""
    rules = Kinematics(instance, is_still=True)
    area = instance.exit
    way_out = make_footprint(*area.centre, (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2)
    makers = {is_shut: FieldMaker(instance, rules, door_shut=is_shut, refinement=refinement)
              for is_shut in (True, False)}
    goals = [(target.footprint, instance.compute_press_reach(target)) for target in instance.targets]

    def find(goal: tuple[Footprint, float], is_shut: bool, also_avoid: Sequence[tuple[Footprint, float]] = ()
             ) -> NDArray[np.int16]:
        maker = makers[is_shut]
        seeds = maker.find_seeds(*goal)
        allowed = np.ones(len(maker.points), dtype=np.bool_)
        for shape, reach in [*(other for other in goals if other is not goal), *also_avoid]:
            allowed &= compute_distance_many(maker.points, stack_footprints([shape])) > reach
        careful, bold = (maker.make_field(seeds, cells).astype(np.int64) for cells in (allowed, None))
        field = np.where(careful >= 0, careful, np.where(bold >= 0, bold + int(OTHER_PRESS_COST), -1))
        field = field.reshape(len(maker.points), -1)
        field[~maker.standing] = -1
        return field.astype(np.int16)

    fields = [field for goal in goals for field in (find(goal, True), find(goal, False, [(way_out, 0.0)]))]
    values = np.stack([*fields, find((way_out, 0.0), False)])
    grid = makers[True]
    return InstanceFields(values, np.ones(len(values), dtype=np.float32), (float(grid.low[0]), float(grid.low[1])),
                          grid.size, grid.shape, 0.0)


def run_first_options(instances: Sequence[RoomInstance], make: Callable[[RoomInstance], InstanceFields], count: int
                      ) -> tuple[NDArray[np.int64], float]:
    """Primitives of one option in each of `count` rooms, 0 where it did not reach its goal, and s of making fields."""
    own, cost_to_go._compute = cost_to_go._compute, make  # the only place where fields are made
    cost_to_go._CACHE.clear()
    try:
        began = read_clock()
        env = BatchedOptionsEnv(count, instance=list(instances), include_primitives=False, autoreset=False)
        seconds = read_clock() - began
    finally:
        cost_to_go._compute = own
        cost_to_go._CACHE.clear()
    env.reset(0)
    drawn = torch.randint(1 << 30, (count,), generator=torch.Generator().manual_seed(0))
    mask = env.action_mask
    action = (mask.cumsum(1) > (drawn % mask.sum(1)).unsqueeze(1)).to(torch.int64).argmax(1)
    durations, is_done = torch.zeros(count, dtype=torch.int64), torch.zeros(count, dtype=torch.bool)
    for _ in range(MOST_STEPS):
        ended = env.step(torch.where(is_done, -1, action))
        durations = torch.where(ended.where & (ended.ended == REACHED), ended.duration, durations)
        is_done |= ended.where
        if is_done.all():
            break
    return durations.numpy(), seconds


@dataclass(frozen=True)
class Args:
    """Presets and size of the measurement."""

    presets: tuple[str, ...] = ("clutter", "ten-button", "dead-ends", "four-button-chain", "twenty-button")
    rooms: int = 12
    """Rooms of each preset."""
    options: int = 240
    """Options that are run in them."""
    refinements: tuple[int, ...] = (0, 1)
    """Times that the planners' cells are halved."""


def main(args: Args) -> None:
    """Print one line of a table for each preset and kind of field."""
    print("preset | fields | primitives | ratio | seconds to make | not reached")
    for preset in args.presets:
        instances = [generate(get_preset(preset), seed) for seed in range(args.rooms)]
        base, seconds = run_first_options(instances, cost_to_go._compute, args.options)
        print(f"{preset} | own | {base[base > 0].mean():.2f} | 1 | {seconds:.1f} | {(base == 0).sum()}", flush=True)
        for refinement in args.refinements:
            found, seconds = run_first_options(
                instances, lambda room, halved=refinement: make_planner_fields(room, halved), args.options)
            both = (base > 0) & (found > 0)
            print(f"{preset} | planners', halved {refinement} times | {found[both].mean():.2f} | "
                  f"{found[both].sum() / base[both].sum():.3f} | {seconds:.1f} | {(found == 0).sum()}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
