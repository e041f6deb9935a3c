"""Ranges of a schematic: the numbers that one instance draws, and the frame that all instances share."""

from __future__ import annotations

import numpy as np

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.settings import fill_ranges, list_ranges


def sample_puzzle(config: RoomConfig, seed: int) -> tuple[RoomConfig, Puzzle]:
    """Sample the numbers and the puzzle of an instance, in a fraction of the time of `generate`.

    Returns the schematic with numbers in place of ranges, and the instance's puzzle.
    """
    config = _draw_ranges(config, np.random.default_rng([seed, 2]))
    return config, config.puzzle.make_puzzle(np.random.default_rng([seed, 0]))


def _draw_ranges(config: RoomConfig, rng: np.random.Generator) -> RoomConfig:
    """Draw a number from every range of a schematic, uniformly, ends included."""
    values = {path: _draw(between.low, between.high, rng) for path, between in list_ranges(config).items()}
    return fill_ranges(config, values) if values else config


def _draw(low: float, high: float, rng: np.random.Generator) -> float:
    if isinstance(low, int) and isinstance(high, int):
        return int(rng.integers(low, high, endpoint=True))
    return float(rng.uniform(low, high))


def make_frame(config: RoomConfig) -> SpaceLayout | None:
    """Make the frame that all instances share; None where they all have the same size.

    Instances differ in size if the schematic has ranges, or a door in a random wall, behind which the exit adds to the
    floor on that side.
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
