"""Randomly generated factored domains, after Hallak et al. (2015): factors with values, and one panel per factor.

A press changes its factor's value by a permutation that depends on the values of the factor's parents; with probability
1 - `success` it has no effect. The exit opens while every factor has its goal value. Permutations can be undone, which
rules out dead ends. Enumeration finds the states furthest from the start, and the goal is drawn from them. Every domain
is therefore solvable, with a known optimum. Results published for other generators do not transfer.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig, Success, register_puzzle
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.places import Panels
from hrl_escape.env.puzzles.symbolic import Effect, Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

MOST_ENUMERATED = 4096
"""Largest number of states of a domain: arity to the power of the number of factors."""

Arity = Annotated[int, Range(2, 8)]
FactorNumber = Annotated[int, Range(0, 11)]


@dataclasses.dataclass(frozen=True)
class FactoredConfig(PuzzleConfig):
    """Configuration of a factored domain; the instance seed draws parents, permutations and goal."""

    kind = "factored"
    count: Annotated[int, Range(1, 12)] = 5
    """Number of factors, each with a panel."""
    arity: Arity = 3
    """Number of values of a factor. More values make goals further away."""
    max_parents: Annotated[int, Range(0, 3)] = 2
    """Most parents of a factor. More parents make the effect of a press depend on more values."""
    success: Success = 0.9
    """Probability that a press has its effect; otherwise it has none."""
    buttons: Panels = Panels(width=0.8)
    """Sizes and places of the panels."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        super().check()
        if self.arity**self.count > MOST_ENUMERATED:
            raise ConfigError("puzzle.count", self.count,
                              f"arity^count at most {MOST_ENUMERATED}, the limit of the enumeration")

    def make_puzzle(self, rng: np.random.Generator) -> FactoredPuzzle:
        """Sample domains until some goal is at least `count` presses away, then one of the furthest goals."""
        while True:
            parents = tuple(self._draw_parents(factor, rng) for factor in range(self.count))
            turns = tuple(tuple(int(value) for _ in range(self.arity ** len(others))
                                for value in rng.permutation(self.arity)) for others in parents)
            drawn = FactoredPuzzle(self.count, self.arity, parents, turns, 1, self.success)
            furthest = max(drawn.distances.values())
            if furthest >= self.count:
                goals = sorted(state for state, distance in drawn.distances.items() if distance == furthest)
                return dataclasses.replace(drawn, goal=goals[int(rng.integers(len(goals)))])

    def _draw_parents(self, factor: int, rng: np.random.Generator) -> tuple[int, ...]:
        others = [other for other in range(self.count) if other != factor]
        number = int(rng.integers(min(self.max_parents, len(others)) + 1))
        return tuple(sorted(int(other) for other in rng.choice(others, number, replace=False)) if number else ())


@dataclasses.dataclass(frozen=True)
class FactoredPuzzle(Graphed, Modelled, Puzzle):
    """A concrete domain. Factor i is named `factor-<i+1>`; its value is the digit of weight arity^i of the state."""

    kind = "factored"
    count: Annotated[int, Range(1, 12)] = 1
    """Number of factors, each with a panel."""
    arity: Arity = 2
    """Number of values of a factor."""
    parents: tuple[tuple[FactorNumber, ...], ...] = ((),)
    """Parents of each factor: the factors that decide the effect of a press."""
    turns: tuple[tuple[Annotated[int, Range(0, 7)], ...], ...] = ((1, 0),)
    """Value of each factor after a press, for each setting of its parents (the first has weight 1) and each value."""
    goal: Annotated[int, Range(0, MOST_ENUMERATED - 1)] = 1
    """State that opens the exit."""
    success: Success = 1.0
    """Probability that a press has its effect."""

    def check(self) -> None:
        """Check the tables, that presses can be undone, and the goal."""
        if self.arity**self.count > MOST_ENUMERATED:
            raise ConfigError("puzzle.count", self.count, f"arity^count at most {MOST_ENUMERATED}")
        if self.goal >= self.arity**self.count:
            raise ConfigError("puzzle.goal", self.goal, f"below {self.arity**self.count}")
        if len(self.parents) != self.count or any(
                other >= self.count or others.count(other) > 1 or other == factor
                for factor, others in enumerate(self.parents) for other in others):
            raise ConfigError("puzzle.parents", self.parents, f"distinct other factors for each of {self.count}")
        if len(self.turns) != self.count or any(
                len(turns) != self.arity ** (len(others) + 1) or any(
                    sorted(turns[at : at + self.arity]) != list(range(self.arity))
                    for at in range(0, len(turns), self.arity))
                for others, turns in zip(self.parents, self.turns, strict=False)):
            raise ConfigError("puzzle.turns", self.turns, "one permutation for each setting of a factor's parents")

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the panels, `factor-1` to `factor-<count>`."""
        return tuple(f"factor-{i + 1}" for i in range(self.count))

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child): the value of the parent decides the effect of pressing the child."""
        return tuple((other, factor) for factor, others in enumerate(self.parents) for other in others)

    def decode(self, state: int) -> tuple[int, ...]:
        """Return the value of each factor."""
        return tuple(state // self.arity**factor % self.arity for factor in range(self.count))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state that can reach the goal."""
        return type(state) is int and state in self.distances

    @cached_property
    def distances(self) -> dict[int, int]:
        """Fewest effective presses from state 0 to each reachable state."""
        distances, queue = {0: 0}, [0]
        for state in queue:
            for factor in range(self.count):
                after = self.turn(state, factor)
                if after not in distances:
                    distances[after] = distances[state] + 1
                    queue.append(after)
        return distances

    def turn(self, state: int, factor: int) -> int:
        """Return the state after an effective press of a factor."""
        values = self.decode(state)
        setting = sum(values[other] * self.arity**place for place, other in enumerate(self.parents[factor]))
        then = self.turns[factor][setting * self.arity + values[factor]]
        return state + (then - values[factor]) * self.arity**factor

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order; one random number decides for all presses of a primitive."""
        if contacts.uniform < self.success:
            for factor in contacts.pressed:
                state = self.turn(state, factor)
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether every factor has its goal value."""
        return state == self.goal

    def observe(self, state: int) -> tuple[float, ...]:
        """Return a one-hot vector per factor for its value, then the same for the goal."""
        return tuple(float(value == own) for word in (state, self.goal) for own in self.decode(word)
                     for value in range(self.arity))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each factor has its goal value."""
        return tuple(own == goal for own, goal in zip(self.decode(state), self.decode(self.goal), strict=True))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `at(factor-i,value)` for every factor."""
        return frozenset(self._name(factor, value) for factor, value in enumerate(self.decode(state)))

    def _name(self, factor: int, value: int) -> str:
        return f"at({self.target_names[factor]},{value})"

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per factor, with a conditional effect per setting of parents and value."""
        operators = []
        for factor, name in enumerate(self.target_names):
            effects = []
            read = (*reversed(self.parents[factor]), factor)
            settings = itertools.product(range(self.arity), repeat=len(read))
            for then, values in zip(self.turns[factor], settings, strict=True):
                if then != values[-1]:
                    facts = frozenset(map(self._name, read, values))
                    effects.append(Effect(facts, add=frozenset({self._name(factor, then)}),
                                          delete=frozenset({self._name(factor, values[-1])})))
            operators.append(Operator(f"press-{name}", name, "press", when=tuple(effects)))
        facts = tuple(self._name(factor, value) for factor in range(self.count) for value in range(self.arity))
        return SymbolicModel(facts, tuple(operators), self.get_facts(self.goal))


register_puzzle(FactoredConfig, FactoredPuzzle)
