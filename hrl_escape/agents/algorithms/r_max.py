"""R-MAX: optimism about unknown pairs of state and action, and planning (Brafman and Tennenholtz 2002).

It runs over decisions of any duration, as in R-MAXQ's lowest level (Jong and Stone 2008): a pair of state and action is
known after `visits` samples, and value iteration solves the model of known pairs. It has no factors: experience in one
state does not transfer to another, and the states that it has to visit grow exponentially with the number of buttons.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_legal
from hrl_escape.agents.components.tables import make_discretiser
from hrl_escape.agents.factored.observation import FactorReader
from hrl_escape.agents.single_env import SwitchingAgent
from hrl_escape.agents.state import Kept, pack_columns, unpack_columns
from hrl_escape.settings import Range

SWEEPS = 20_000
"""Largest number of sweeps of value iteration, for discounts near 1."""


@dataclass(frozen=True, kw_only=True)
class RMaxSettings(AgentSettings):
    """Settings of `r-max`: states, samples that make a pair known, and the value of unknown pairs."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    visits: Annotated[int, Range(1)] = 1
    """m, samples that make a pair of state and action known. 1 is enough for deterministic outcomes; more are needed
    under noise."""
    optimistic_value: float = 100.0
    """Value of an unknown pair, in units of return. It must bound all true values from above; higher values explore
    more."""
    states: Literal["factors", "cells"] = "factors"
    """`factors`: a state is its discrete components, in a room the puzzle's bits, without the pose. `cells`: all
    components, rounded by `bins` and `resolution`."""
    tolerance: Annotated[float, Range(0, open_low=True)] = 1e-9
    """Tolerance of value iteration, which stops when all changes are smaller. Smaller values are more precise and
    slower."""


_KEPT = SMDPTransition._fields[:-2]  # without the flag of truncation and the trace


class RMax(SwitchingAgent):
    """Optimism over a table: every pair is tried `visits` times before its model is used."""

    settings: RMaxSettings
    STATE = (Kept("_history", pack=lambda history: pack_columns(history, _KEPT),
                  unpack=lambda saved: [SMDPTransition(*row) for row in unpack_columns(saved, _KEPT)]),
             "_values", Kept("_is_stale", "stale"), "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: RMaxSettings | None = None) -> None:
        self.settings = settings or RMaxSettings()
        self._actions = count_actions(action_space, "r-max")
        self._reader: FactorReader | None = None
        self._discretise: Callable[[Any], bytes] | None = None
        if self.settings.states == "factors":
            self._reader = FactorReader(observation_space, "r-max")
        else:
            self._discretise = make_discretiser(observation_space, self.settings, "r-max")
        self._rng = make_rng(seed, "actions")
        self._history: list[SMDPTransition] = []
        self._rebuild()

    def _rebuild(self) -> None:
        """Rebuild the table from the history after the definition of states has changed."""
        self._numbers: dict[bytes, int] = {}
        self._legal: list[NDArray[np.bool_]] = []  # by state, actions that were ever legal
        self._counts: list[NDArray[np.int64]] = []
        self._rewards: list[NDArray[np.float64]] = []
        self._weights: list[dict[tuple[int, int], float]] = []  # by state, (action, next state) -> sum of gamma^k
        self._values = np.zeros(0)
        self._is_stale = True
        self._known_values: NDArray[np.float64] | None = None  # from known pairs only; a function of the counts
        for transition in self._history:
            self._learn(transition)

    def _key(self, observation: Any) -> bytes:
        if self._reader is None:
            assert self._discretise is not None
            return self._discretise(observation)
        return self._reader.read(self._reader.flatten(observation)).tobytes()

    def _number(self, observation: Any) -> int:
        """The state's row, which is created at the first visit."""
        key = self._key(observation)
        if key not in self._numbers:
            self._numbers[key] = len(self._legal)
            self._legal.append(np.zeros(self._actions, dtype=np.bool_))
            self._counts.append(np.zeros(self._actions, dtype=np.int64))
            self._rewards.append(np.zeros(self._actions))
            self._weights.append({})
        return self._numbers[key]

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return an unknown legal action if there is one, otherwise the best by the optimistic model."""
        number = self._numbers.get(self._key(observation))
        counts = np.zeros(self._actions) if number is None else self._counts[number]
        unknown = action_mask & (counts < self.settings.visits)
        if number is None or unknown.any():
            return sample_legal(unknown, self._rng)
        if self._is_stale:
            self._values, self._is_stale = self._solve(self._values, self.settings.optimistic_value), False
        return self._choose(number, self._values, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the best action by known pairs only, or a random one without known pairs."""
        number = self._numbers.get(self._key(observation))
        if number is None:
            return sample_legal(action_mask, rng)
        if self._known_values is None:
            self._known_values = self._solve(np.zeros(0), None)  # from zero, which makes evaluations reproducible
        return self._choose(number, self._known_values, action_mask, rng)

    def _choose(self, number: int, values: NDArray[np.float64], mask: NDArray[np.bool_], rng: np.random.Generator
                ) -> int:
        known = mask & (self._counts[number] >= self.settings.visits)
        if not known.any():
            return sample_legal(mask, rng)
        return choose_best(self._compute_row(number, values), known, rng)

    def _compute_row(self, number: int, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Q(s, .) of the empirical model at given state values, (actions,)."""
        row = self._rewards[number].copy()
        for (action, after), weight in self._weights[number].items():
            row[action] += weight * values[after]
        return row / np.maximum(self._counts[number], 1)

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .) of the optimistic model, float64 (actions,): `optimistic_value` for unknown pairs."""
        unknown = np.full(self._actions, float(self.settings.optimistic_value))
        number = self._numbers.get(self._key(observation))
        if number is None:
            return unknown
        values = self._solve(self._values, self.settings.optimistic_value)
        is_known = self._counts[number] >= self.settings.visits
        return np.where(is_known, self._compute_row(number, values), unknown)

    def _solve(self, values: NDArray[np.float64], unknown: float | None) -> NDArray[np.float64]:
        """Value iteration over the visited states, (states,), from earlier values, possibly of fewer states.

        `unknown` is the value of unknown pairs, or None to leave them out. A state without any remaining pair gets the
        value of staying there forever.
        """
        states = len(self._legal)
        counts, legal = np.array(self._counts), np.array(self._legal)
        known = counts >= self.settings.visits
        divisor = np.maximum(counts, 1).ravel()
        reward = np.array(self._rewards).ravel() / divisor
        entries = [(s * self._actions + a, n, w) for s, row in enumerate(self._weights) for (a, n), w in row.items()]
        pairs, nexts = (np.array([entry[i] for entry in entries], dtype=np.int64) for i in (0, 1))
        weights = np.array([entry[2] for entry in entries]) / divisor[pairs]
        floor = min(float(reward.min(initial=0.0)) / max(1.0 - self.gamma, 1e-3), 0.0)
        start = floor if unknown is None else unknown
        current = np.concatenate([values, np.full(states - len(values), start)])
        for _ in range(SWEEPS):
            q = (reward + np.bincount(pairs, weights * current[nexts], states * self._actions)).reshape(states, -1)
            if unknown is None:
                after = np.where(known, q, -np.inf).max(axis=1)
                after[~known.any(axis=1)] = floor
            else:
                after = np.where(known, q, np.where(legal, unknown, -np.inf)).max(axis=1)
                after[~(known | legal).any(axis=1)] = unknown
            moved = np.abs(after - current).max(initial=0.0)
            current = after
            if moved <= self.settings.tolerance:
                break
        return current

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Count the decision, and plan again when a pair's samples have doubled or show something new."""
        if transition.cut:
            return {}  # an action that was cut inside has no outcome
        kept = transition._replace(trace=())
        self._history.append(kept)
        flats = [] if self._reader is None else [
            self._reader.flatten(each) for each in (kept.observation, kept.next_observation)
        ]
        if self._reader is not None and self._reader.notice(np.stack(flats)):
            self._rebuild()
        else:
            self._learn(kept)
        return {"states": len(self._legal)}

    def _learn(self, transition: SMDPTransition) -> None:
        action = transition.action
        before, after = self._number(transition.observation), self._number(transition.next_observation)
        is_new = bool((transition.action_mask & ~self._legal[before]).any())
        self._legal[before] |= transition.action_mask
        if not transition.terminated:
            is_new |= bool((transition.next_action_mask & ~self._legal[after]).any())
            self._legal[after] |= transition.next_action_mask
            key = action, after
            is_new |= key not in self._weights[before]
            self._weights[before][key] = self._weights[before].get(key, 0.0) + transition.discount
        self._rewards[before][action] += transition.reward
        self._counts[before][action] += 1
        count = int(self._counts[before][action])
        if is_new or count == self.settings.visits or (count > self.settings.visits and count & (count - 1) == 0):
            self._is_stale = True
        self._known_values = None

    def after_load(self) -> None:
        """Rebuild the table from the history; the values are stored."""
        if self._reader is not None and self._history:
            observations = [each for row in self._history for each in (row.observation, row.next_observation)]
            self._reader.notice(np.stack([self._reader.flatten(each) for each in observations]))
        kept = self._values, self._is_stale
        self._rebuild()
        self._values, self._is_stale = kept
