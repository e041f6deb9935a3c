"""Graph of the states that an agent has met, the model of its actions, and options found in it.

Its slow directions are those of a random walk on it: the eigenvectors of small eigenvalue of its Laplacian (Chung
1997), and those of large eigenvalue of its successor representation (Machado et al. 2018). Each comes with its largest
number positive. Options are tables from states to primitives, with an end where there is no entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from hrl_escape.agents.state import Kept, Stateful, pack_keys, unpack_keys

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
    """States by number in order of first meeting, and counts of what actions did."""

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
        """Number of a state; None for one never met."""
        return self._numbers.get(key)

    def number(self, key: bytes) -> int:
        """Number of a state, a new one at the first meeting."""
        return self._numbers.setdefault(key, len(self._numbers))

    def add(self, before: bytes, action: int, after: bytes) -> None:
        """Count one decision, between states by key."""
        edge = self.number(before), action, self.number(after)
        self._counts[edge] = self._counts.get(edge, 0) + 1

    def make_model(self) -> StateModel:
        """Empirical model of the actions."""
        before, action, after, count = _list_edges(self._counts).T
        states, pairs = len(self), before * self.actions + action
        totals = np.bincount(pairs, count, states * self.actions)
        follow = sparse.csr_matrix((count / totals[pairs], (pairs, after)), (states * self.actions, states))
        return StateModel(follow, (totals > 0).reshape(states, self.actions))

    def make_adjacency(self) -> sparse.csr_matrix:
        """1 between different states where some action led from one to the other, either way."""
        before, _, after, _ = _list_edges(self._counts).T
        moves = before != after
        pairs = np.concatenate([np.stack([before, after]), np.stack([after, before])], axis=1)[:, np.tile(moves, 2)]
        edges = sparse.csr_matrix((np.ones(pairs.shape[1]), pairs), (len(self), len(self)))
        edges.data[:] = 1.0
        return edges

    def find_component(self, adjacency: sparse.csr_matrix) -> NDArray[np.int64]:
        """States of the largest connected part, in order."""
        _, parts = csgraph.connected_components(adjacency, directed=False)
        return np.flatnonzero(parts == np.bincount(parts).argmax())


LaplacianKind = Literal["random-walk", "normalised", "combinatorial"]
"""`random-walk`: I - D^-1 A, of the walk that draws an edge; `normalised`: I - D^(-1/2) A D^(-1/2), whose vectors are
those times D^(1/2); `combinatorial`: D - A, of a walk that draws one of as many actions everywhere and stays where an
action leads nowhere."""


class Directions(NamedTuple):
    """Slow directions of a walk, the slowest first, the constant one left out."""

    eigenvalues: NDArray[np.float64]  # (directions,)
    vectors: NDArray[np.float64]  # (states, directions), of either sign


def compute_laplacian(adjacency: NDArray[np.float64], kind: LaplacianKind) -> NDArray[np.float64]:
    """Laplacian of an undirected graph of which no state is without an edge, (states, states)."""
    degrees = adjacency.sum(axis=1)
    laplacian = np.diag(degrees) - adjacency
    if kind == "combinatorial":
        return laplacian
    return laplacian / (degrees[:, None] if kind == "random-walk" else np.sqrt(np.outer(degrees, degrees)))


def find_slow_directions(adjacency: NDArray[np.float64], count: int, kind: LaplacianKind) -> Directions:
    """Right eigenvectors of the Laplacian of a connected graph, given by its adjacency, (states, states)."""
    symmetric = compute_laplacian(adjacency, "normalised" if kind == "random-walk" else kind)
    values, vectors = np.linalg.eigh(symmetric)
    if kind == "random-walk":
        vectors = vectors / np.sqrt(adjacency.sum(axis=1))[:, None]
    return Directions(values[1 : count + 1], _orient(vectors[:, 1 : count + 1]))


def compute_successor_representation(transition: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    """Discounted visits of each state after each state, (I - gamma P)^-1 (Dayan 1993), P (states, states)."""
    return np.asarray(np.linalg.inv(np.eye(len(transition)) - gamma * transition), np.float64)


def find_slow_directions_of_successors(successors: NDArray[np.float64], count: int) -> Directions:
    """Right eigenvectors of large eigenvalue of a successor representation; eigenvalues are those of I - gamma P.

    A directed walk may have complex ones, of which the real parts are taken.
    """
    values, vectors = (np.real(part) for part in np.linalg.eig(successors))
    order = np.argsort(-values, kind="stable")[1 : count + 1]
    return Directions(1 / values[order], _orient(vectors[:, order]))


def _orient(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same vectors, the number of largest size in each positive."""
    largest = np.abs(vectors).argmax(axis=0)
    return vectors * np.sign(vectors[largest, np.arange(vectors.shape[1])])


def find_covering_edge(adjacency: NDArray[np.float64]) -> tuple[int, int]:
    """Edge that a covering option adds: from the least to the greatest value of the slowest direction.

    Jinnai et al. (2019), who bound the cover time by the second eigenvalue, which this edge raises.
    """
    (vector,) = find_slow_directions(adjacency, 1, "random-walk").vectors.T
    return int(vector.argmin()), int(vector.argmax())


# --- options found in the model ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TableSkill:
    """A deterministic Markov option over numbered states."""

    name: str  # tells it from others
    actions: NDArray[np.int64]  # int64 (states,), the primitive in each state, `NOTHING` where it ends
    starts: NDArray[np.bool_]  # bool (states,), where it may begin


def _iterate(model: StateModel, values: NDArray[np.float64], gamma: float, gain: NDArray[np.float64] | float,
             settle: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Gain + gamma P V, (states, actions), at the fixed point of V = settle(its maximum over actions)."""
    for _ in range(_SWEEPS):
        choices = gain + gamma * (model.follow @ values).reshape(model.known.shape)
        swept = settle(choices.max(axis=1))
        change, values = np.abs(swept - values).max(initial=0.0), swept
        if change < 1e-12:
            break
    return gain + gamma * (model.follow @ values).reshape(model.known.shape)


def make_eigenoption(name: str, model: StateModel, purpose: NDArray[np.float64], gamma: float) -> TableSkill:
    """Option that climbs a function of the state: paid e(s') - e(s), over where no more can be earned.

    The purpose e is (states,); its negative is another option. Gamma, below 1, discounts the option's own reward.

    Machado et al. (2017): the policy is optimal with one further action, to end, that earns nothing.
    """
    gain = np.where(model.known, (model.follow @ purpose).reshape(model.known.shape) - purpose[:, None], -np.inf)
    choices = _iterate(model, np.zeros(len(gain)), gamma, gain, lambda best: np.maximum(best, 0.0))
    best = choices.max(axis=1, keepdims=True)
    chosen = np.where(best[:, 0] > _TIE, (choices >= best - _TIE).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, chosen != NOTHING)


def make_point_option(name: str, model: StateModel, start: int, goal: int, gamma: float = 0.99) -> TableSkill:
    """Option from one state to another, to be there soon (Jinnai et al. 2019).

    It may begin in `start` alone, and ends in `goal`, and where no way there is known.
    """
    states = np.arange(len(model.known))
    option = make_subgoal_option(name, model, states == states, states == goal, gamma)
    return TableSkill(name, option.actions, option.starts & (states == start))


def make_subgoal_option(name: str, model: StateModel, inside: NDArray[np.bool_], targets: NDArray[np.bool_],
                        gamma: float = 0.99) -> TableSkill:
    """Option that stays `inside`, bool (states,), until it is in one of its targets, bool (states,), to be there soon.

    It maximises the expected gamma^k of arriving. It may begin wherever a way to a target is known that stays inside,
    so that it is never begun where it cannot arrive; it ends in targets, and everywhere else.
    """
    choices = _iterate(model, targets.astype(np.float64), gamma, 0.0,
                       lambda best: np.where(targets, 1.0, np.where(inside, best, 0.0)))
    best = choices.max(axis=1, keepdims=True)
    on_the_way = (best[:, 0] > 0) & inside & ~targets
    chosen = np.where(on_the_way, (choices >= best * (1 - _TIE)).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, on_the_way)
