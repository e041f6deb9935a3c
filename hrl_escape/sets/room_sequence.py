"""Room sequences: an episode visits one room of each set, in order; see `SequenceEnv`."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.errors import ConfigError
from hrl_escape.sets.instance_set import InstanceSet

SEQUENCE_HORIZON = 20_000
"""Horizon of an episode over all rooms of a sequence, primitives."""


class RoomSequence:
    """Sets of rooms, one for each position of a sequence; every room has the horizon of the sequence.

    Args:
        sets: one for each position, in order.
        paired: an episode uses the rooms of one number in all sets, which have equal sizes; otherwise each room is
            drawn independently.
    """

    def __init__(self, sets: Sequence[InstanceSet], paired: bool = False) -> None:
        self.paired = paired
        self.sets = tuple(InstanceSet(rooms.name, dataclasses.replace(rooms.config, horizon=SEQUENCE_HORIZON),
                                      rooms.seeds) for rooms in sets)
        self.name = f"{self.sets[0].name} and {len(self.sets) - 1} more"

    def __len__(self) -> int:
        return sum(map(len, self.sets))

    def __getitem__(self, index: int) -> RoomInstance:
        return self.sets[0][index]

    def describe(self) -> dict[str, Any]:
        """Return the sequence as JSON values, for `load_rooms`."""
        parts = [rooms.describe() for rooms in self.sets]
        digest = hashlib.sha256("".join(part["id"] for part in parts).encode()).hexdigest()
        return {"id": digest[:16], "content": {"sequence": [part["content"] for part in parts],
                                               **({"paired": True} if self.paired else {})}}


def repeat_set(rooms: InstanceSet, count: int) -> RoomSequence:
    """Make a sequence of several rooms of one set whose cues share one latent code in each episode.

    Codes with fewer than `count` rooms are left out.

    Args:
        rooms: set of rooms whose cues have latent codes.
        count: number of rooms in the sequence.

    Raises:
        ConfigError: the cues have no latent codes, `count` is below 2, or the set is too small.
    """
    puzzle, name = rooms.config.puzzle, f"{rooms.name} x {count}"
    if count < 2 or not isinstance(puzzle, ButtonsConfig) or puzzle.cues.latent_codes < 2:
        raise ConfigError("room", name, "a sequence repeats a set two or more times, and requires cues with "
                          "latent codes")
    groups: dict[int, list[int]] = defaultdict(list)
    for seed in rooms.seeds:
        drawn: Any = sample_puzzle(rooms.config, seed)[1]
        groups[puzzle.cues.find_code(drawn.cues, drawn.edge_list, drawn.goal)].append(seed)
    kept = [group for _, group in sorted(groups.items()) if len(group) >= count]
    if not kept:
        raise ConfigError("room", name, f"a sequence of {count} needs {count} rooms of one latent code")
    return RoomSequence([InstanceSet(name, rooms.config, [seed for group in kept
                                     for seed in (*group[position:], *group[:position])])
                         for position in range(count)], paired=True)


RoomSets: TypeAlias = "InstanceSet | RoomSequence"
"""A set of rooms, one for each episode, or a sequence, one for each position."""


def list_sets(rooms: RoomSets) -> tuple[InstanceSet, ...]:
    """Return the sets of a sequence, or a single set."""
    return rooms.sets if isinstance(rooms, RoomSequence) else (rooms,)


def load_rooms(content: Mapping[str, Any]) -> RoomSets:
    """Make rooms from the content of their description."""
    if "sequence" in content:
        return RoomSequence([InstanceSet.from_description(rooms) for rooms in content["sequence"]],
                            bool(content.get("paired")))
    return InstanceSet.from_description(content)
