"""Spectral analysis of a state graph: Laplacians, slow directions, successor representation, covering edges.

The slow directions of a random walk are the eigenvectors of small eigenvalue of its Laplacian (Chung 1997), and those
of large eigenvalue of its successor representation (Machado et al. 2018). Each comes with its largest number positive.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Directions", "LaplacianKind", "compute_laplacian", "compute_successor_representation", "find_covering_edge",
           "find_slow_directions", "find_slow_directions_of_successors"]

LaplacianKind = Literal["random-walk", "normalised", "combinatorial"]
"""`random-walk`: I - D^-1 A, of the walk that draws an edge; `normalised`: I - D^(-1/2) A D^(-1/2), whose vectors are
those times D^(1/2); `combinatorial`: D - A, of a walk that draws one of as many actions everywhere and stays where an
action leads nowhere."""


class Directions(NamedTuple):
    """Slow directions of a walk, the slowest first, the constant one left out.

    Attributes:
        eigenvalues: (directions,).
        vectors: (states, directions), of either sign.
    """

    eigenvalues: NDArray[np.float64]
    vectors: NDArray[np.float64]


def compute_laplacian(adjacency: NDArray[np.float64], kind: LaplacianKind) -> NDArray[np.float64]:
    """Laplacian of an undirected graph, (states, states).

    Args:
        adjacency: symmetric, (states, states); no state without an edge.
        kind: see `LaplacianKind`.
    """
    degrees = adjacency.sum(axis=1)
    laplacian = np.diag(degrees) - adjacency
    if kind == "combinatorial":
        return laplacian
    return laplacian / (degrees[:, None] if kind == "random-walk" else np.sqrt(np.outer(degrees, degrees)))


def find_slow_directions(adjacency: NDArray[np.float64], count: int, kind: LaplacianKind) -> Directions:
    """Right eigenvectors of the Laplacian of a connected graph.

    Args:
        adjacency: symmetric, (states, states).
        count: how many.
        kind: see `LaplacianKind`.
    """
    symmetric = compute_laplacian(adjacency, "normalised" if kind == "random-walk" else kind)
    values, vectors = np.linalg.eigh(symmetric)
    if kind == "random-walk":
        vectors = vectors / np.sqrt(adjacency.sum(axis=1))[:, None]
    return Directions(values[1 : count + 1], _orient(vectors[:, 1 : count + 1]))


def compute_successor_representation(transition: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    """Discounted visits of each state after each state, (I - gamma P)^-1 (Dayan 1993).

    Args:
        transition: P of a policy, (states, states).
        gamma: discount, below 1.
    """
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
