"""Discovery: the graph of an agent's visited states, options found in it, and agents that use them.

Its slow directions are the slow directions of a random walk on it. They are the eigenvectors of small eigenvalue of its
Laplacian (Chung 1997), or of large eigenvalue of its successor representation (Machado et al. 2018). The largest number
of each is positive. Options are tables from states to primitives, and end in states without an entry.

Found options occupy slots of a declared maximum. An empty slot is masked, and numbers never change. A new option
replaces the former one of the same number.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from hrl_escape.agents.agent import (
    MarkovRun,
    OptionPolicy,
    RunningCall,
    SMDPTransition,
    compute_backup,
    count_actions,
)
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, sample_legal
from hrl_escape.agents.components.tables import QTable, TabularAgent
from hrl_escape.agents.state import Kept, Stateful, StateTree, pack_keys, unpack_keys

NOTHING = -1
"""In place of a primitive: the option ends, or cannot be."""
_SWEEPS = 10_000  # of value iteration, at most
_TIE = 1e-9


class StateModel(NamedTuple):
    """Learned model of a finite walk."""

    follow: sparse.csr_matrix
    """(states * actions, states), probability of each next state; rows of 0 where nothing is known."""
    known: NDArray[np.bool_]  # bool (states, actions), pairs that were tried


def _list_edges(counts: dict[tuple[int, int, int], int]) -> NDArray[np.int64]:
    """Before, action, after, count of each, (edges, 4)."""
    return np.array([(*edge, count) for edge, count in counts.items()], np.int64).reshape(-1, 4)


class StateGraph(Stateful):
    """States numbered by first visit, and counts of the outcomes of actions."""

    STATE = (
        Kept("_numbers", "keys", pack_keys, lambda keys: {key: number for number, key in enumerate(unpack_keys(keys))}),
        Kept("_counts", "edges", _list_edges,
             lambda edges: {(int(b), int(a), int(n)): int(count) for b, a, n, count in edges}),
    )

    def __init__(self, actions: int) -> None:
        self.actions = actions
        self._numbers: dict[bytes, int] = {}
        self._counts: dict[tuple[int, int, int], int] = {}

    def __len__(self) -> int:
        return len(self._numbers)

    def find(self, key: bytes) -> int | None:
        """Return the number of a state, or None before its first visit."""
        return self._numbers.get(key)

    def number(self, key: bytes) -> int:
        """Return the number of a state, a new one at its first visit."""
        return self._numbers.setdefault(key, len(self._numbers))

    def add(self, before: bytes, action: int, after: bytes) -> None:
        """Count one decision, between states by key."""
        edge = self.number(before), action, self.number(after)
        self._counts[edge] = self._counts.get(edge, 0) + 1

    def make_model(self) -> StateModel:
        """Return the empirical model of the actions."""
        before, action, after, count = _list_edges(self._counts).T
        states, pairs = len(self), before * self.actions + action
        totals = np.bincount(pairs, count, states * self.actions)
        follow = sparse.csr_matrix((count / totals[pairs], (pairs, after)), (states * self.actions, states))
        return StateModel(follow, (totals > 0).reshape(states, self.actions))

    def make_adjacency(self) -> sparse.csr_matrix:
        """Return the adjacency of different states, 1 if an action led from one to the other, in either direction."""
        before, _, after, _ = _list_edges(self._counts).T
        moves = before != after
        pairs = np.concatenate([np.stack([before, after]), np.stack([after, before])], axis=1)[:, np.tile(moves, 2)]
        edges = sparse.csr_matrix((np.ones(pairs.shape[1]), pairs), (len(self), len(self)))
        edges.data[:] = 1.0
        return edges

    def find_component(self, adjacency: sparse.csr_matrix) -> NDArray[np.int64]:
        """Return the states of the largest connected part, in order."""
        _, parts = csgraph.connected_components(adjacency, directed=False)
        return np.flatnonzero(parts == np.bincount(parts).argmax())


LaplacianKind = Literal["random-walk", "normalised", "combinatorial"]
"""`random-walk`: I - D^-1 A, of the walk that draws an edge. `normalised`: I - D^(-1/2) A D^(-1/2), whose vectors are
the same times D^(1/2). `combinatorial`: D - A, of a walk that draws among equally many actions in every state, and
stays if an action has no edge."""


class Directions(NamedTuple):
    """Slow directions of a walk, the slowest first, the constant one left out."""

    eigenvalues: NDArray[np.float64]  # (directions,)
    vectors: NDArray[np.float64]  # (states, directions), of either sign


def compute_laplacian(adjacency: NDArray[np.float64], kind: LaplacianKind) -> NDArray[np.float64]:
    """Return the Laplacian of an undirected graph without isolated states, (states, states)."""
    degrees = adjacency.sum(axis=1)
    laplacian = np.diag(degrees) - adjacency
    if kind == "combinatorial":
        return laplacian
    return laplacian / (degrees[:, None] if kind == "random-walk" else np.sqrt(np.outer(degrees, degrees)))


def find_slow_directions(adjacency: NDArray[np.float64], count: int, kind: LaplacianKind) -> Directions:
    """Return right eigenvectors of the Laplacian of a connected graph, from its adjacency, (states, states)."""
    symmetric = compute_laplacian(adjacency, "normalised" if kind == "random-walk" else kind)
    values, vectors = np.linalg.eigh(symmetric)
    if kind == "random-walk":
        vectors = vectors / np.sqrt(adjacency.sum(axis=1))[:, None]
    return Directions(values[1 : count + 1], _orient(vectors[:, 1 : count + 1]))


def compute_successor_representation(transition: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    """Return the successor representation (I - gamma P)^-1 (Dayan 1993) of P (states, states)."""
    return np.asarray(np.linalg.inv(np.eye(len(transition)) - gamma * transition), np.float64)


def find_slow_directions_of_successors(successors: NDArray[np.float64], count: int) -> Directions:
    """Return right eigenvectors of large eigenvalue of a successor representation; eigenvalues are for I - gamma P.

    A directed walk can have complex ones; then the real parts are used.
    """
    values, vectors = (np.real(part) for part in np.linalg.eig(successors))
    order = np.argsort(-values, kind="stable")[1 : count + 1]
    return Directions(1 / values[order], _orient(vectors[:, order]))


def _orient(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vectors with signs that make the number of largest size positive."""
    largest = np.abs(vectors).argmax(axis=0)
    return vectors * np.sign(vectors[largest, np.arange(vectors.shape[1])])


def find_covering_edge(adjacency: NDArray[np.float64]) -> tuple[int, int]:
    """Return the edge of a covering option, from the least to the greatest value of the slowest direction.

    Jinnai et al. (2019), who bound the cover time by the second eigenvalue, which this edge raises.
    """
    (vector,) = find_slow_directions(adjacency, 1, "random-walk").vectors.T
    return int(vector.argmin()), int(vector.argmax())


# --- options found in the model ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TableSkill:
    """A deterministic Markov option over numbered states."""

    name: str  # unique
    actions: NDArray[np.int64]  # int64 (states,), the primitive in each state, `NOTHING` where it ends
    starts: NDArray[np.bool_]  # bool (states,), its initiation set


def _iterate(model: StateModel, values: NDArray[np.float64], gamma: float, gain: NDArray[np.float64] | float,
             settle: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return gain + gamma P V, (states, actions), at the fixed point of V = settle(its maximum over actions)."""
    for _ in range(_SWEEPS):
        choices = gain + gamma * (model.follow @ values).reshape(model.known.shape)
        swept = settle(choices.max(axis=1))
        change, values = np.abs(swept - values).max(initial=0.0), swept
        if change < 1e-12:
            break
    return gain + gamma * (model.follow @ values).reshape(model.known.shape)


def make_eigenoption(name: str, model: StateModel, purpose: NDArray[np.float64], gamma: float) -> TableSkill:
    """Make an eigenoption: it maximises the reward e(s') - e(s), and ends where the reward cannot grow.

    The purpose e is (states,); its negative is another option. Gamma, below 1, discounts the option's own reward.

    Machado et al. (2017): the policy is optimal with one further action, to end, that earns nothing.
    """
    gain = np.where(model.known, (model.follow @ purpose).reshape(model.known.shape) - purpose[:, None], -np.inf)
    choices = _iterate(model, np.zeros(len(gain)), gamma, gain, lambda best: np.maximum(best, 0.0))
    best = choices.max(axis=1, keepdims=True)
    chosen = np.where(best[:, 0] > _TIE, (choices >= best - _TIE).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, chosen != NOTHING)


def make_point_option(name: str, model: StateModel, start: int, goal: int, gamma: float = 0.99) -> TableSkill:
    """Make an option from one state to another by the shortest expected way (Jinnai et al. 2019).

    It can only begin in `start`. It ends in `goal`, and in states without a known way there.
    """
    states = np.arange(len(model.known))
    option = make_subgoal_option(name, model, states == states, states == goal, gamma)
    return TableSkill(name, option.actions, option.starts & (states == start))


def make_subgoal_option(name: str, model: StateModel, inside: NDArray[np.bool_], targets: NDArray[np.bool_],
                        gamma: float = 0.99) -> TableSkill:
    """Make an option that stays `inside`, bool (states,), on the way to its targets, bool (states,).

    It maximises the expected gamma^k of arriving. It can begin where a way inside to a target is known.
    It ends in targets, and outside.
    """
    choices = _iterate(model, targets.astype(np.float64), gamma, 0.0,
                       lambda best: np.where(targets, 1.0, np.where(inside, best, 0.0)))
    best = choices.max(axis=1, keepdims=True)
    on_the_way = (best[:, 0] > 0) & inside & ~targets
    chosen = np.where(on_the_way, (choices >= best * (1 - _TIE)).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, on_the_way)


# --- agents that find options while they learn ---------------------------------------------


class Discovery(Stateful, ABC):
    """Finds options in the data of an agent; its state is everything except the graph that decides what is found.

    Attributes:
        slots: maximum number of options at a time.
    """

    slots: int

    @abstractmethod
    def observe(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Process one decision, between states of these numbers in the graph."""

    @abstractmethod
    def propose(self, graph: StateGraph) -> Mapping[int, TableSkill]:
        """Return new options by slot, usually none."""


def save_skills(skills: Sequence[TableSkill | None]) -> list[StateTree | None]:
    """Convert options to state trees, for checkpoints."""
    return [None if skill is None else dict(vars(skill)) for skill in skills]


def load_skills(saved: Sequence[StateTree | None]) -> list[Any]:
    """Return options from the result of `save_skills`."""
    return [None if skill is None else TableSkill(skill["name"], np.array(skill["actions"]), np.array(skill["starts"]))
            for skill in saved]


class DiscoveringAgent(TabularAgent):
    """Q-learning over primitives and the options that a discovery finds.

    For each primitive (s, a) -> r, s' and each option o that would have done a in s, with `use="choose"`:

        Q(s, o) <- Q(s, o) + alpha [r + gamma (Q(s', o) if o continues in s' else max over o' of Q(s', o')) - Q(s, o)]

    Attributes:
        graph: the visited states.
        skills: by slot, None in empty slots.
    """

    Discovery: ClassVar[type[Any]]
    """Constructor of the algorithm's `Discovery` from its settings."""
    STATE = ("graph", Kept("skills", pack=save_skills, unpack=load_skills), "discovery", "_running", "_lasted")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self.actions = count_actions(action_space, self.name)
        self.graph = StateGraph(self.actions)
        self.discovery = self.Discovery(self.settings)
        self.skills: list[TableSkill | None] = [None] * self.discovery.slots
        self._chooses = self.settings.use == "choose"
        self.table = QTable(self.actions + self.discovery.slots * self._chooses, self.settings)
        self._running = NOTHING
        """Slot of the running option."""
        self._lasted = 0
        self._shown: RunningCall | None = None

    # --- options at a state -----------------------------------------------------------

    def get_skill_action(self, slot: int, observation: Any) -> int:
        """Return the primitive of the option in a slot, `NOTHING` where it ends."""
        skill, state = self.skills[slot], self.graph.find(self._discretise(observation))
        return NOTHING if skill is None or state is None or state >= len(skill.actions) else int(skill.actions[state])

    def compute_available(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the options that can begin here, bool (slots,)."""
        state = self.graph.find(self._discretise(observation))
        available = np.zeros(len(self.skills), np.bool_)
        if state is not None:
            for slot, skill in enumerate(self.skills):
                if skill is not None and state < len(skill.actions) and skill.starts[state]:
                    available[slot] = skill.actions[state] != NOTHING and action_mask[skill.actions[state]]
        return available

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .) of primitives, float64 (actions,)."""
        return super().compute_values(observation)[: self.actions]

    def _compute_choices(self, observation: Any, mask: NDArray[np.bool_]) -> tuple[NDArray, NDArray[np.bool_]]:
        """Return the values of all choices of the policy, and the mask of legal ones."""
        if not self._chooses:
            return self.compute_values(observation), mask
        values = super().compute_values(observation)
        return values, np.concatenate([mask, self.compute_available(observation, mask)])

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the option of the latest choice."""
        return () if self._shown is None else (self._shown,)

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return the found options, or the whole policy without any."""
        found = [slot for slot, skill in enumerate(self.skills) if skill is not None]
        return tuple(map(self._export, found)) or super().get_options()

    def _export(self, slot: int) -> OptionPolicy:
        """Return the option of a slot; where it is over, it chooses any legal action."""
        skill = self.skills[slot]
        assert skill is not None

        def act(observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
            action = self.go_on(slot, observation, action_mask)
            return int(action_mask.argmax()) if action == NOTHING else action

        run = MarkovRun(act, lambda observation, mask: self.go_on(slot, observation, mask) == NOTHING)
        return OptionPolicy(skill.name, self, lambda: run,
                            lambda observation, mask: bool(self.compute_available(observation, mask)[slot]),
                            is_markov=True)

    # --- acting -----------------------------------------------------------------------

    def go_on(self, slot: int, observation: Any, mask: NDArray[np.bool_]) -> int:
        """Return the primitive of a running option, `NOTHING` where it is over."""
        action = NOTHING if slot == NOTHING else self.get_skill_action(slot, observation)
        return action if action != NOTHING and mask[action] else NOTHING

    def _show(self, slot: int, lasted: int) -> None:
        skill = None if slot == NOTHING else self.skills[slot]
        self._shown = None if skill is None else RunningCall(skill.name, None, lasted, 0.0)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Continue a running option, or choose epsilon-greedily; an exploratory choice is an option or a primitive."""
        action = self.go_on(self._running, observation, action_mask)
        if action == NOTHING:
            choice = self._choose(observation, action_mask)
            self._running, self._lasted = (choice - self.actions, 0) if choice >= self.actions else (NOTHING, 0)
            action = choice if self._running == NOTHING else self.get_skill_action(self._running, observation)
        self._show(self._running, self._lasted)
        return action

    def _choose(self, observation: Any, mask: NDArray[np.bool_]) -> int:
        if self._rng.random() < compute_epsilon(self.settings, self._steps):
            available = self.compute_available(observation, mask)
            if available.any() and self._rng.random() < self.settings.option_share:
                return self.actions + sample_legal(available, self._rng)
            return sample_legal(mask, self._rng)
        return choose_best(*self._compute_choices(observation, mask), self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the best choice; an option runs to its end in the evaluation of `rng`."""
        (running,) = self.recall(rng) or (NOTHING,)
        action = self.go_on(running, observation, action_mask)
        if action == NOTHING:
            choice = choose_best(*self._compute_choices(observation, action_mask), rng)
            running = choice - self.actions if choice >= self.actions else NOTHING
            action = choice if running == NOTHING else self.get_skill_action(running, observation)
        self._evaluation = rng, running
        self._show(running, 0)
        return action

    # --- learning ---------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn values, add the decision to the graph, and adopt proposed options."""
        before, after = (self._discretise(o) for o in (transition.observation, transition.next_observation))
        if not transition.cut:
            self.graph.add(before, transition.action, after)
        error = self._learn(transition)
        self._lasted += 1
        if transition.terminated or transition.truncated:
            self._running = NOTHING
        self.discovery.observe(transition, self.graph.number(before), self.graph.number(after))
        for slot, skill in self.discovery.propose(self.graph).items():
            self._place(slot, skill)
        found = sum(skill is not None for skill in self.skills)
        return self.finish_decision(transition, error) | {"skills": found}

    def _place(self, slot: int, skill: TableSkill) -> None:
        """Put an option into a slot, and reset the values of a former one there."""
        former, self.skills[slot] = self.skills[slot], skill
        is_same = former is not None and np.array_equal(former.actions, skill.actions)
        if self._chooses and former is not None and not is_same:
            self.table.forget(self.actions + slot)
        if self._running == slot:
            self._running = NOTHING

    def _learn(self, transition: SMDPTransition) -> float:
        key = self._discretise(transition.observation)
        reward, bootstrap = compute_backup(transition, self.settings)
        values, legal = self._compute_choices(transition.next_observation, transition.next_action_mask)
        best = float(values[legal].max())
        doing = [slot for slot in range(len(self.skills) * self._chooses)
                 if self.get_skill_action(slot, transition.observation) == transition.action]
        targets = []
        for slot in doing:
            goes_on = self.go_on(slot, transition.next_observation, transition.next_action_mask) != NOTHING
            targets.append(reward + bootstrap * (float(values[self.actions + slot]) if goes_on else best))
        for slot, target in zip(doing, targets, strict=True):
            self.table.update(key, self.actions + slot, target)
        return self.table.update(key, transition.action, reward + bootstrap * best)


class GraphDiscovery(Discovery):
    """Base of discoveries that search the graph at fixed intervals."""

    STATE = ("_decisions",)

    def __init__(self, settings: Any, slots: int) -> None:
        self._every, self._most_states, self.slots = settings.discover_every, settings.most_states, slots
        self._decisions = 0

    def observe(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Count the decision; the graph holds the rest."""
        self._decisions += 1

    def propose(self, graph: StateGraph) -> Mapping[int, TableSkill]:
        """Return all options, if they are due and some states are connected."""
        if self._decisions % self._every or len(graph) > self._most_states:
            return {}
        adjacency = graph.make_adjacency()
        states = graph.find_component(adjacency)
        if len(states) < 3:
            return {}
        return self.find(graph.make_model(), adjacency[states][:, states].toarray(), states)

    @abstractmethod
    def find(self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
             ) -> Mapping[int, TableSkill]:
        """Find options by slot in the largest connected part: its adjacency, and the numbers of its states."""
