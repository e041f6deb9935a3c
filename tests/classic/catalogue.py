"""Every textbook environment by name, in each of its variants."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from tests.classic.barrier_maze import BarrierMaze
from tests.classic.chain import Chain
from tests.classic.empty_room import EmptyRoom
from tests.classic.four_rooms import FourRooms
from tests.classic.key_door import KeyDoor
from tests.classic.parr_maze import ParrMaze
from tests.classic.tabular import TabularEnv
from tests.classic.taxi import Taxi
from tests.classic.winding_maze import WindingMaze

ENVIRONMENTS: dict[str, Callable[..., TabularEnv]] = {
    "four-rooms": partial(FourRooms, slip="none"),
    "four-rooms-extra": partial(FourRooms, slip="extra"),
    "four-rooms-neighbour": partial(FourRooms, slip="neighbour"),
    "four-rooms-direction": partial(FourRooms, slip="direction"),
    "taxi": Taxi,
    "taxi-noisy": partial(Taxi, noisy=True),
    "taxi-fickle": partial(Taxi, fickle=True),
    "taxi-noisy-fickle": partial(Taxi, noisy=True, fickle=True),
    "chain": Chain,
    "chain-position": partial(Chain, visited=False),
    "empty-room": EmptyRoom,
    "key-door": KeyDoor,
    "key-door-aliased": partial(KeyDoor, aliased=True),
    "parr-maze": ParrMaze,
    "barrier-maze": BarrierMaze,
    "winding-maze": WindingMaze,
    "winding-maze-open": partial(WindingMaze, turns=2, aliased=False),
}
"""Each also takes `horizon`."""
