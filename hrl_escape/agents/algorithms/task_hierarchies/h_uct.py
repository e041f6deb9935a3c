"""H-UCT: Monte Carlo tree search over a task graph, with a simulator instead of learning.

Vien and Toussaint (2015), Hierarchical Monte-Carlo planning, for observable states. Each task searches with its own
counts; a child's return is a reward to its caller, as in MAXQ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_legal
from hrl_escape.agents.components.tables import make_discretiser
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.hierarchy.task_graph import GraphTask, flat, freeze, get_graph, get_task
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


class Sampled(NamedTuple):
    """One simulated primitive: its reward, its next observation, and its number of environment steps."""

    reward: float
    next_observation: Any
    next_mask: NDArray[np.bool_]
    terminated: bool
    duration: int = 1


Simulator = Callable[[Any, int, np.random.Generator], Sampled]
"""Samples the outcome of a primitive: (observation, primitive, rng) -> sample."""


_Met = dict[tuple[bytes, int], list[Sampled]]
"""(state, primitive) -> observed outcomes, used without a simulator."""


@dataclass(frozen=True, kw_only=True)
class HUctSettings(AgentSettings):
    """Settings of `h-uct`: size and exploration of the searches."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "always"
    """Plan from the root again at each primitive, instead of running calls to their end: never, in evaluation
    only, or always."""
    simulations: Annotated[int, Range(1)] = 200
    """Simulations for each choice of each running task. More plan better and take longer."""
    depth: Annotated[int, Range(1)] = 100
    """Largest number of primitives of a simulation. More look further ahead and take longer."""
    patience: Annotated[int, Range(0)] = 0
    """Most primitives of a simulated call below the first; 0 sets no limit before `depth`."""
    exploration: Annotated[float, Range(0)] = 0.5
    """Weight c of the bonus for choices with few tries, in units of the range of returns. More explores more."""
    return_range: Annotated[float, Range(0)] = 0.0
    """Largest minus smallest return of a task. 0 measures it in each task, which underestimates rare rewards, and uses
    1 while all returns are equal."""
    visits: Annotated[int, Range(1)] = 1
    """Samples that make a pair of state and primitive known, without a simulator. 1 is enough for deterministic
    outcomes."""
    optimistic_value: float = 0.0
    """Return of an unknown pair, without a simulator. Higher values explore more."""


def _save_met(met: _Met) -> list[Any]:
    return [[np.frombuffer(state, np.uint8), primitive, [list(each) for each in samples]]
            for (state, primitive), samples in met.items()]


def _load_met(saved: list[Any]) -> _Met:
    return {
        (np.asarray(key, np.uint8).tobytes(), int(primitive)): [
            Sampled(float(reward), seen, np.asarray(mask, np.bool_), bool(terminated), int(duration))
            for reward, seen, mask, terminated, duration in samples
        ]
        for key, primitive, samples in saved
    }


class HUct(CallRunner):
    """Upper confidence bounds at every task of a graph.

    In task i at state s, visited N times, it tries each legal child c once, then chooses

        argmax over c of  V(c, s) + D(i, s, c) + b sqrt(log N / n_c),   b = c (largest - smallest return of task i)

    V(c, s) is the mean reward of a primitive, or the value of a task's best child. D and C are means of gamma^k times
    what i earned after c, with and without the pseudo-reward of i's end: i chooses by D and reports C to its caller.
    Simulations try unvisited children at random, and are random hierarchical walks beyond the tree. Every choice is
    planned with new counts.

    Args:
        observation_space: space of the observations, for tasks without a view of their own.
        hierarchy: result of `maxq(graph, until)`; without one, a single task over all primitives, which is UCT.
        simulator: simulator of the environment; without one, outcomes are drawn from the observed ones.
    """

    Settings: ClassVar[type] = HUctSettings
    STATE = (Kept("_met", pack=_save_met, unpack=_load_met), "_search_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HUctSettings | None = None, hierarchy: Hierarchy | None = None,
                 simulator: Simulator | None = None) -> None:
        settings = settings or HUctSettings()
        super().__init__(hierarchy or flat(count_actions(action_space, "h-uct")), seed, settings)
        get_graph(self.hierarchy, "h-uct")
        self._discretise = make_discretiser(observation_space, settings, "h-uct")
        self._simulator = simulator
        self.privileges += ("simulator",) * (simulator is not None)
        self._met: _Met = {}
        self._search_rng = make_rng(seed, "search")

    def make_key(self, task: GraphTask, seen: Seen) -> Hashable:
        """Return the key of a task at a moment, from the task's view."""
        view = task.views.get(None)
        return task.name, self._discretise(seen.observation) if view is None else freeze(view(seen))

    def sample(self, seen: Seen, primitive: int, rng: np.random.Generator) -> Sampled:
        """Draw the outcome of a primitive, from the simulator or from observed outcomes."""
        if self._simulator is not None:
            return self._simulator(seen.observation, primitive, rng)
        met = self._met.get((self._discretise(seen.observation), primitive), [])
        if len(met) < self.settings.visits:
            return Sampled(self.settings.optimistic_value, seen.observation, seen.mask, True)
        return met[int(rng.integers(len(met)))]

    def plan(self, task: GraphTask, seen: Seen, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return values of a task's choices after new simulations, (choices,); -inf if illegal or never tried."""
        search = _Search(self, rng)
        for _ in range(self.settings.simulations):
            search.simulate(task, seen, self.settings.depth)
        return search.get_node(task, seen).compute_values(search, task, seen)

    # --- the agent --------------------------------------------------------------------

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Return the best choice, by a search with the agent's generator."""
        return self.choose_greedy(stack, view, legal, seen, self._search_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best choice, by a search with `rng`."""
        if legal.sum() == 1:
            return int(legal.argmax())
        return choose_best(self.plan(get_task(stack), seen, rng), legal, rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Store the outcome, unless the agent has a simulator."""
        if self._simulator is None:
            key = self._discretise(step.seen.observation), step.action
            after, mask, _ = step.next_seen
            sample = Sampled(step.reward, after, mask, step.terminated, step.duration)
            self._met.setdefault(key, []).append(sample)
        return {"states": len({state for state, _ in self._met})}


class _Run(NamedTuple):
    """Outcome of a simulated call: R and gamma^k from its beginning, primitives, and final observation."""

    reward: float
    discount: float
    primitives: int
    seen: Seen
    terminated: bool


class _Node:
    """Counts and means of one task in one state, by choice."""

    def __init__(self, choices: int) -> None:
        self.visits = 0
        self.counts = np.zeros(choices, np.int64)
        """Number of tries of each choice, with the running simulation, which can return to the same state."""
        self.finished = np.zeros(choices, np.int64)
        """Number of tries with a known continuation."""
        self.rewards = np.zeros(choices)
        """Mean reward of the child."""
        self.own = np.zeros(choices)
        """D: mean of the continuation, with pseudo-reward."""
        self.told = np.zeros(choices)
        """C: the same without pseudo-reward."""

    def record(self, choice: int, reward: float, own: float, told: float) -> None:
        """Update the means of a choice."""
        self.finished[choice] += 1
        count = self.finished[choice]
        for means, value in ((self.rewards, reward), (self.own, own), (self.told, told)):
            means[choice] += (value - means[choice]) / count

    def compute_values(self, search: _Search, task: GraphTask, seen: Seen) -> NDArray[np.float64]:
        """Return V(c, s) + D(i, s, c), (choices,); -inf if never tried."""
        tried = [self.get_reward(search, task, seen, choice) + self.own[choice] if self.finished[choice] else -np.inf
                 for choice in range(len(self.counts))]  # fmt: skip
        return np.array(tried)

    def get_reward(self, search: _Search, task: GraphTask, seen: Seen, choice: int) -> float:
        """Return V(c, s): the mean reward of a primitive, or the value of a task's best choice to its caller."""
        child = task.children[choice]
        if isinstance(child, int):
            return float(self.rewards[choice])
        node = search.get_node(child, seen)
        if not node.finished.any():  # the caller's view covers several states, and the child ran in another one
            return float(self.rewards[choice])
        best = int(node.compute_values(search, child, seen).argmax())
        return node.get_reward(search, child, seen, best) + float(node.told[best])


@dataclass
class _Search:
    """The search tree of one choice."""

    agent: HUct
    rng: np.random.Generator
    nodes: dict[Hashable, _Node] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Task -> smallest and largest return, with pseudo-reward."""

    def get_node(self, task: GraphTask, seen: Seen) -> _Node:
        key = self.agent.make_key(task, seen)
        if key not in self.nodes:
            self.nodes[key] = _Node(len(task.children))
        return self.nodes[key]

    def select(self, task: GraphTask, seen: Seen, node: _Node, legal: NDArray[np.bool_]) -> int:
        """Return a random untried legal child, or the one with the highest upper confidence bound.

        In a state that the simulation returns to before all its children are known, it chooses at random.
        """
        fresh = legal & (node.finished == 0)
        if fresh.any():
            is_back = bool((node.counts > node.finished).any())
            return sample_legal(legal if is_back else fresh, self.rng)
        low, high = self.ranges[task.name]
        bonus = self.agent.settings.exploration * (self.agent.settings.return_range or (high - low) or 1.0)
        values = node.compute_values(self, task, seen) + bonus * np.sqrt(math.log(node.visits) / node.counts.clip(1))
        return choose_best(values, legal, self.rng)

    def simulate(self, task: GraphTask, seen: Seen, budget: int, inside: bool = False) -> _Run:
        """Run a task to its end, or to the end of the budget, and learn from each of its choices."""
        settings, gamma = self.agent.settings, self.agent.gamma
        if inside and settings.patience:
            budget = min(budget, settings.patience)
        trail: list[tuple[_Node, int, float, float]] = []
        primitives, terminated, discount = 0, False, 1.0
        while primitives < budget and not terminated and not task.until(seen):
            legal = task.legal(seen, None)
            if not legal.any():
                break
            node = self.get_node(task, seen)
            choice = self.select(task, seen, node, legal)
            node.visits, node.counts[choice] = node.visits + 1, node.counts[choice] + 1
            child = task.children[choice]
            if isinstance(child, int):
                sample = self.agent.sample(seen, child, self.rng)
                after = self.agent.hierarchy.see(sample.next_observation, sample.next_mask)
                run = _Run(sample.reward, gamma**sample.duration, sample.duration, after, sample.terminated)
            else:
                run = self.simulate(child, seen, budget - primitives, inside=True)
            trail.append((node, choice, run.reward, run.discount))
            seen, terminated = run.seen, run.terminated
            primitives, discount = primitives + run.primitives, discount * run.discount
        told = 0.0
        own = task.pseudo(seen) if task.pseudo is not None and task.until(seen) else 0.0
        for node, choice, reward, passed in reversed(trail):
            node.record(choice, reward, passed * own, passed * told)
            own, told = reward + passed * own, reward + passed * told
            low, high = self.ranges.get(task.name, (own, own))
            self.ranges[task.name] = min(low, own), max(high, own)
        return _Run(told, discount, primitives, seen, terminated)
