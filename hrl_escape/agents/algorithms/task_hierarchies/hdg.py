"""HDG: distances to goals, learned for all near goals at once, and by way of landmarks for distant ones.

Kaelbling (1993), Hierarchical learning in stochastic domains. Every primitive updates the distances to all goals that
are stored at its state, and the agent can therefore reach goals that it never pursued.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, MarkovRun, OptionPolicy, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    make_rng,
    sample_legal,
)
from hrl_escape.agents.components.tables import make_discretiser
from hrl_escape.agents.hierarchy.task_graph import freeze
from hrl_escape.agents.single_env import SwitchingAgent
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import AgentSettingsError, UnsupportedError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class Landmarks:
    """States that represent the region around them."""

    states: tuple[Hashable, ...]  # states of the landmarks
    region: Callable[[Hashable], int]  # state -> index of the landmark of its region
    state: Callable[[Any], Hashable] = int  # observation -> state; the observation itself by default

    def __post_init__(self) -> None:
        for number, state in enumerate(self.states):
            if self.region(state) != number:
                raise AgentSettingsError("Landmarks.region", state, f"{number}, its own region, for landmark {number}")


@dataclass(frozen=True, kw_only=True)
class HdgSettings(AgentSettings):
    """Settings of `hdg`: step sizes of distances, targets on long ways, and rounding of states without landmarks."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive of logged returns; distances are in primitives, without discount."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of a distance. 1 suits deterministic environments; smaller values average noise."""
    neighbours: bool = True
    """Also aim directly at goals in neighbouring regions, not only in the current one. Without it, walks whose best way
    crosses a border turn back at it forever."""
    next_landmark: Literal["from-state", "from-landmark"] = "from-state"
    """Next landmark on the way to a distant region: on the shortest way from the state or, as in the paper, from the
    landmark of the state's region."""
    dead_end: Annotated[float, Range(0)] = 1_000.0
    """Distance in primitives that the end of an episode adds on the way to another state."""
    most_states: Annotated[int, Range(1)] = 4_000
    """Most states; memory grows with its square."""


class Hdg(SwitchingAgent):
    """Distances D from each state, by action, to the goals stored there: near ones and all landmarks.

    After a from s to s' in k primitives, for every goal g of s, which are those in its region and neighbouring ones:

        D(s, a, g) <- D(s, a, g) + alpha [k + [s' is not g] d(s', g) - D(s, a, g)]
        d(s', g)    = min over a' of D(s', a', g)              if s' stores g
                      d(s', l) + d(l, g), l the landmark of g  otherwise

    Minima are over the actions that were ever legal in a state, or over all actions of a state that was never left. If
    the episode ended in another state than g, `dead_end` replaces d(s', g). The agent acts by D(s, ., g), ties at
    random, if the goal's region is its own or a neighbouring one. Otherwise it acts by D(s, ., l') for the next
    landmark l' on the shortest way over landmarks (Floyd and Warshall, over edges between neighbouring regions), see
    `next_landmark`. All distances begin at 0, which is optimistic and makes the agent try everything.

    Args:
        observation_space: observation space, for states without landmarks.
        landmarks: landmarks and their regions; by default a single region.
        goal: observation -> goal state; by default the nearest state where an episode has terminated.
    """

    Settings: ClassVar[type] = HdgSettings

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HdgSettings | None = None, landmarks: Landmarks | None = None,
                 goal: Callable[[Any], Hashable] | None = None) -> None:
        self.settings = settings = settings or HdgSettings()
        self._actions = count_actions(action_space, "hdg")
        self._landmarks, self._goal = landmarks, goal
        self.privileges = () if landmarks is None else ("landmarks",)
        self._find_state: Callable[[Any], Hashable] = (
            make_discretiser(observation_space, settings, "hdg") if landmarks is None else landmarks.state)
        self._rng = make_rng(seed, "actions")
        self._steps = 0
        self._begin()

    def _begin(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._regions = np.zeros(0, np.int64)
        self.distances = np.zeros((0, 0, self._actions))
        """Distances (states, goals, actions), by number of the state."""
        self._legal = np.zeros((0, self._actions), np.bool_)
        """Actions that were ever legal, (states, actions); none in a state that was never left."""
        self._terminal: list[int] = []
        count = 1 if self._landmarks is None else len(self._landmarks.states)
        self._borders = np.eye(count, dtype=np.bool_)
        """True for regions that are neighbours or equal, (regions, regions)."""
        for state in () if self._landmarks is None else self._landmarks.states:
            self.number(state)

    def number(self, state: Hashable) -> int:
        """Return the number of a state, a new one at its first visit; landmarks have the first numbers."""
        state = freeze(state)
        if state not in self._numbers:
            number = len(self._numbers)
            if number >= self.settings.most_states:
                raise UnsupportedError(f"hdg met more than {number} states. Raise `most_states`, or give landmarks a "
                                       "coarser `state`")  # fmt: skip
            if number == len(self.distances):
                more = max(64, 2 * number) - number
                self.distances = np.pad(self.distances, ((0, more), (0, more), (0, 0)))
                self._regions, self._legal = np.pad(self._regions, (0, more)), np.pad(self._legal, ((0, more), (0, 0)))
            self._numbers[state] = number
            self._regions[number] = 0 if self._landmarks is None else self._landmarks.region(state)
        return self._numbers[state]

    def _keeps(self, state: int) -> NDArray[np.bool_]:
        """Goals stored at a state, (states met,)."""
        met = len(self._numbers)
        kept = self._borders[self._regions[state], self._regions[:met]]
        kept[: 0 if self._landmarks is None else len(self._landmarks.states)] = True
        return kept

    def _minimise(self, states: Any, ends: Any) -> NDArray[np.float64]:
        """Minimum of D over the legal actions, for state and goal numbers that broadcast."""
        legal = self._legal[states]
        return np.where(legal | ~legal.any(axis=-1, keepdims=True), self.distances[states, ends], np.inf).min(axis=-1)

    def _estimate(self, state: int) -> NDArray[np.float64]:
        """d(s, g) of every state met, (states met,); over the goal's landmark if it is not stored."""
        goals = np.arange(len(self._numbers))
        estimate = self._minimise(state, goals)
        if self._landmarks is not None:
            landmark = self._regions[goals]
            far = estimate[landmark] + self._minimise(landmark, goals)
            estimate = np.where(self._keeps(state), estimate, far)
        estimate[state] = 0.0
        return estimate

    def compute_ways(self) -> NDArray[np.float64]:
        """Return the shortest lengths over landmarks, (regions, regions)."""
        regions = np.arange(len(self._borders))
        ways = np.where(self._borders, self._minimise(regions[:, None], regions), np.inf)
        np.fill_diagonal(ways, 0.0)
        for middle in regions:
            ways = np.minimum(ways, ways[:, middle, None] + ways[None, middle, :])
        return ways

    def choose_target(self, state: int, goal: int) -> int:
        """Return the state to aim at: the goal, or the next landmark on the way to it."""
        here, there = int(self._regions[state]), int(self._regions[goal])
        if here == there or (self.settings.neighbours and self._borders[here, there]) or self._landmarks is None:
            return goal
        ways = self.compute_ways()
        begin = state if self.settings.next_landmark == "from-state" else here
        ways_on = np.where(self._borders[here], self._minimise(begin, np.arange(len(ways))) + ways[:, there], np.inf)
        ways_on[here] = np.inf
        return int(ways_on.argmin()) if np.isfinite(ways_on).any() else goal

    def _find_goal(self, observation: Any, state: int) -> int | None:
        if self._goal is not None:
            return self._numbers.get(freeze(self._goal(observation)))
        if not self._terminal:
            return None
        return self._terminal[int(self._minimise(state, self._terminal).argmin())]

    def _choose(self, observation: Any, mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        state = self.find_number(observation)
        goal = None if state is None else self._find_goal(observation, state)
        if state is None or goal is None:
            return sample_legal(mask, rng)
        return self.choose_towards(state, goal, mask, rng)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return an epsilon-greedy action; a random one before a goal is known."""
        if self._rng.random() < compute_epsilon(self.settings, self._steps):
            return sample_legal(action_mask, self._rng)
        return self._choose(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return an action on the estimated shortest way."""
        return self._choose(observation, action_mask, rng)

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return the way to each landmark; without landmarks, the whole policy."""
        if self._landmarks is None:
            return super().get_options()
        return tuple(self._export(number) for number in range(len(self._landmarks.states)))

    def _export(self, landmark: int) -> OptionPolicy:
        """The way to one landmark, from visited states until it is reached."""

        def act(observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
            state = self.find_number(observation)
            return int(action_mask.argmax()) if state is None else self.choose_towards(state, landmark, action_mask)

        def can_start(observation: Any, action_mask: NDArray[np.bool_]) -> bool:
            return self.find_number(observation) not in (None, landmark)

        run = MarkovRun(act, lambda observation, mask: not can_start(observation, mask))
        return OptionPolicy(f"landmark {landmark}", self, lambda: run, can_start, is_markov=True)

    def find_number(self, observation: Any) -> int | None:
        """Return the number of an observation's state, or None if it is new."""
        return self._numbers.get(freeze(self._find_state(observation)))

    def choose_towards(self, state: int, goal: int, mask: NDArray[np.bool_],
                       rng: np.random.Generator | None = None) -> int:
        """Return the primitive on the estimated shortest way to a goal; ties at random, the first without `rng`."""
        return choose_best(-self.distances[state, self.choose_target(state, goal)], mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Make one backup for every stored goal."""
        before = self.number(self._find_state(transition.observation))
        after = self.number(self._find_state(transition.next_observation))
        self._legal[before] |= transition.action_mask
        self._borders[self._regions[before], self._regions[after]] = True
        self._borders[self._regions[after], self._regions[before]] = True
        if transition.terminated and self._goal is None and after not in self._terminal:
            self._terminal.append(after)
        estimate = self._estimate(after)
        if transition.terminated:
            estimate = np.where(np.arange(len(estimate)) == after, 0.0, self.settings.dead_end)
        target = transition.duration + estimate
        updated = self._keeps(before)
        updated[after] |= transition.terminated
        updated[before] = False
        row = self.distances[before, : len(updated), transition.action]
        error = np.where(updated, target - row, 0.0)
        row += self.settings.learning_rate * error
        self._steps += transition.duration
        return {"distance_error": float(np.abs(error).max()), "states": len(self._numbers)}

    def state_dict(self) -> StateTree:
        """Return states, distances, borders, terminal states, counter and generator."""
        met = len(self._numbers)
        return {
            "states": [repr(state) for state in self._numbers],
            "distances": self.distances[:met, :met],
            "legal": self._legal[:met],
            "borders": self._borders,
            "terminal": self._terminal,
            "steps": self._steps,
            "rng": self._rng.bit_generator.state,
            **super().state_dict(),
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._begin()
        for each in state["states"]:
            self.number(ast.literal_eval(each))
        met = len(self._numbers)
        self.distances[:met, :met], self._legal[:met] = state["distances"], state["legal"]
        self._borders = np.array(state["borders"], np.bool_)
        self._terminal = [int(each) for each in state["terminal"]]
        self._steps = int(state["steps"])
        self._rng.bit_generator.state = state["rng"]
        super().load_state_dict(state)
