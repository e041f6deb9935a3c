"""One learner with parts that can be bought alone: walks, memory and structure.

The learner values all kinds of actions linearly in bits, Q(s, a) = w[place, a] . (1, lights, failed), where
`failed` is there with memory alone. It begins at 0 and pays for every primitive, so what was tried less looks better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.poses import RoomState, list_touched

__all__ = ["LinearQ", "Structure", "WalkTables", "Watched", "find_place"]

Place = tuple[int, ...]


class Watched(gymnasium.Wrapper):
    """Counts the primitives of a room of buttons, and notes every press: what failed, and what was lit when it worked.

    Attributes:
        primitives: since the first episode began.
        state: the room's.
        touched: buttons whose touch began with the latest primitive, as bits.
        failed: lights -> buttons that did not light under them in this episode, both as bits.
        structure: is given presses that worked, and outlives episodes.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.primitives, self.touched = 0, 0
        self.failed: dict[int, int] = {}
        self.structure = Structure()
        self.state: RoomState

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; what failed is forgotten."""
        result = self.env.reset(**kwargs)
        self.state, self.touched = self._room.get_state(), 0
        self.failed.clear()
        return result

    def step(self, action: Any) -> Any:
        """Run a primitive."""
        result = self.env.step(action)
        before, self.state = self.state, self._room.get_state()
        self.primitives += 1
        self.touched = self.state.touching & ~before.touching
        if self.touched:
            self._note(self.lights_of(before), self.touched, self.lights)
        return result

    @property
    def _room(self) -> Any:
        return self.unwrapped

    @staticmethod
    def lights_of(state: RoomState) -> int:
        """Bit i is set while button i is on."""
        assert isinstance(state.puzzle, int), "the state of buttons without doors is their lights"
        return state.puzzle

    @property
    def lights(self) -> int:
        """Present lights, as bits."""
        return self.lights_of(self.state)

    def _note(self, before: int, touched: int, after: int) -> None:
        vain = touched & ~before & ~after
        self.failed[before] = self.failed.get(before, 0) | vain
        if touched & (touched - 1) == 0 and after & touched & ~before:
            self.structure.note(touched.bit_length() - 1, before)


class Structure:
    """Learned dependencies between presses, from presses that worked alone.

    A button may need what was lit every time it lit. So it is known to light wherever all of that is lit.
    """

    def __init__(self) -> None:
        self.needs: dict[int, int] = {}

    def note(self, button: int, lights: int) -> None:
        """A button has lit under these lights."""
        self.needs[button] = self.needs.get(button, -1) & lights

    def list_enabled(self, lights: int, goal: int) -> tuple[bool, list[int]]:
        """Unlit buttons that are known to light now; once a way to the goal is known, those on the way alone.

        Returns:
            Whether a way is known, and the buttons.
        """
        way = self._find_way(goal)
        chosen = self.needs if way is None else way
        return way is not None, [button for button in chosen
                                 if not lights >> button & 1 and self.needs[button] & ~lights == 0]

    def _find_way(self, goal: int) -> list[int] | None:
        """The goal with all it may need; None while the need of one of these is not known."""
        way, frontier = {goal}, [goal]
        while frontier:
            button = frontier.pop()
            if button not in self.needs:
                return None
            for need in list_touched(self.needs[button]):
                if need not in way:
                    way.add(need)
                    frontier.append(need)
        return sorted(way)


class LinearQ:
    """Values of actions, linear in bits, with weights of their own at every place.

    Args:
        actions: their number.
        bits: theirs.
        gamma: discount of a primitive.
        rate: share of the error that an update takes away.
    """

    def __init__(self, actions: int, bits: int, gamma: float, rate: float) -> None:
        self._shape = actions, bits
        self._rate, self._lowest = rate, -1.0 / (1.0 - gamma)
        self._weights: dict[Place, NDArray[np.float64]] = {}

    def compute_values(self, place: Place, bits: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values at a state, (actions,)."""
        weights = self._weights.get(place)
        return np.zeros(self._shape[0]) if weights is None else weights @ bits

    def update(self, place: Place, bits: NDArray[np.float64], action: int, target: float) -> None:
        """Move a value towards a target."""
        weights = self._weights.get(place)
        if weights is None:
            weights = self._weights[place] = np.zeros(self._shape)
        error = min(max(target, self._lowest), 100.0) - weights[action] @ bits
        weights[action] += self._rate * error / (bits @ bits) * bits


class WalkTables:
    """Learned walks: primitives to each button and out of the room, for all of these at once (Kaelbling 1993).

    Every primitive teaches all walks. Costs begin at 0, so what was tried less looks nearer.

    Args:
        goals: their number.
        primitives: number of actions.
        rate: step size.
    """

    def __init__(self, goals: int, primitives: int, rate: float) -> None:
        self._shape, self._rate = (primitives, goals), rate
        self._costs: dict[Place, NDArray[np.float64]] = {}

    def get(self, place: Place) -> NDArray[np.float64]:
        """Costs of primitives to goals at a place, (primitives, goals)."""
        costs = self._costs.get(place)
        if costs is None:
            costs = self._costs[place] = np.zeros(self._shape)
        return costs

    def learn(self, place: Place, primitive: int, after: Place, reached: Sequence[int]) -> None:
        """A primitive led from place to place, and reached some goals."""
        left = self.get(after).min(axis=0)
        left[list(reached)] = 0.0
        row = self.get(place)[primitive]
        row += self._rate * (1.0 + left - row)


def find_place(state: RoomState, cell: float, headings: int, steps: int) -> Place:
    """Cell of the floor and heading, as the tables distinguish them.

    Args:
        state: of the room.
        cell: width, m.
        headings: over a full turn.
        steps: heading steps in a full turn.
    """
    return (math.floor(state.x / cell), math.floor(state.y / cell),
            round(headings * state.heading_steps / steps) % headings)
