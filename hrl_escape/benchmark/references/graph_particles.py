"""Samples of dependency graphs, for rooms with too many graphs to list.

Sequential Monte Carlo with moves (Chopin 2002; Gilks and Berzuini 2001): graphs that a press contradicts are replaced,
and Metropolis steps exchange the labels of two buttons, which leaves the prior unchanged.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.references.graph_family import MOST_BUTTONS, can_light
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import (
    Edges,
    mask_parents,
    sample_relabelled,
)
from hrl_escape.errors import UnsupportedError
from hrl_escape.settings import Between

PARTICLES, SHAKES = 2048, 40
DOUBT = 4.0
"""Negative log-likelihood of a press that a graph contradicts. It is finite, so a sample without a consistent graph can
still reach one."""


class GraphParticles:
    """Sample of the graphs of a room configuration, by their posterior after the presses.

    Args:
        config: the room configuration's puzzle.
        count: number of buttons in the room.
        rng: of draws and moves.
        cues: cue of each button of the room; empty without cues.

    Raises:
        UnsupportedError: the room has cues of several latent codes, dependency cues, or positional cues.

    Attributes:
        parents: uint64 (particles, buttons), the bits of each button's parents.
        goals: int64 (particles,), the button that opens the exit.
    """

    def __init__(self, config: ButtonsConfig, count: int, rng: np.random.Generator, cues: tuple[int, ...] = ()
                 ) -> None:
        if cues and config.cues.latent_codes > 1:
            raise UnsupportedError(f"bayes does not support cues of {config.cues.latent_codes} latent codes with "
                                   f"{count} buttons; it supports them with up to {MOST_BUTTONS}")
        if cues and config.cues.kind == "dependencies":
            raise UnsupportedError(f"bayes does not support dependency cues of {count} buttons; it supports them with "
                                   f"up to {MOST_BUTTONS}")
        if config.positional_cues.sections:
            raise UnsupportedError(f"bayes does not support positional cues with {count} buttons; it supports them "
                                   f"with up to {MOST_BUTTONS}")
        self._rng, self._presses = rng, list[tuple[int, int, bool, bool]]()
        self.parents = np.zeros((PARTICLES, count), np.uint64)
        self.goals = np.zeros(PARTICLES, np.int64)
        self._classes = np.zeros((PARTICLES, count), np.int64)
        for number in range(PARTICLES):
            edges, self.goals[number] = _draw_graph(config, count, rng)
            self.parents[number] = mask_parents(edges, count)
            if cues:
                self._classes[number] = config.cues.classify(count, edges, int(self.goals[number]))
        single = [[config.cues.compute_likelihood((cue,), np.array([[own]]))[0] for own in
                   range(config.cues.classes)] for cue in cues] or [[1.0] * config.cues.classes] * count
        with np.errstate(divide="ignore"):
            self._surprise = -np.log(np.array(single))  # (buttons, classes), infinite for an impossible cue
        self._doubts, self._surprises = self._measure(self.parents, self.goals, self._classes)
        if cues:
            self._resample()
            for _ in range(SHAKES):
                self._shake()

    def learn(self, press: tuple[int, int, bool, bool]) -> None:
        """Condition the sample on a press.

        Args:
            press: the button, bits of the buttons that were on before, whether it turned on, and whether the exit
                opened.
        """
        if press in self._presses:
            return
        self._presses.append(press)
        before = self._surprises
        self._doubts, self._surprises = self._measure(self.parents, self.goals, self._classes)
        self._resample(before)
        for _ in range(SHAKES):
            self._shake()

    def _resample(self, counted: NDArray[np.float64] | float = 0.0) -> None:
        """Resample graphs by their likelihood; `counted` is the energy that their multiplicity already reflects."""
        energy = self._doubts + self._surprises - counted
        likelihood = np.exp(-(energy - energy.min()))
        chosen = self._rng.choice(PARTICLES, PARTICLES, p=likelihood / likelihood.sum())
        for name in ("parents", "goals", "_classes", "_doubts", "_surprises"):
            setattr(self, name, getattr(self, name)[chosen])

    def compute_odds(self, lit: int) -> NDArray[np.float64]:
        """Compute the probability that a press turns each button on, (buttons,); `lit` holds the bits of those on."""
        weights = np.exp(-8.0 * self._doubts)
        weights = weights / weights.sum()
        return weights @ can_light(self.parents, lit)

    def _shake(self) -> None:
        """Metropolis step: exchange the labels of two buttons in each graph."""
        count = self.parents.shape[1]
        first = self._rng.integers(count, size=PARTICLES)
        second = (first + self._rng.integers(1, count, size=PARTICLES)) % count if count > 1 else first
        parents, goals = _exchange(self.parents, self.goals, first, second)
        classes, rows = self._classes.copy(), np.arange(PARTICLES)
        classes[rows, first], classes[rows, second] = self._classes[rows, second], self._classes[rows, first]
        doubts, surprises = self._measure(parents, goals, classes)
        gain = self._doubts + self._surprises - doubts - surprises
        taken = self._rng.random(PARTICLES) < np.exp(np.minimum(gain, 0.0))
        for name, moved in (("parents", parents), ("goals", goals), ("_classes", classes), ("_doubts", doubts),
                            ("_surprises", surprises)):
            getattr(self, name)[taken] = moved[taken]

    def _measure(self, parents: NDArray[np.uint64], goals: NDArray[np.int64], classes: NDArray[np.int64]
                 ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Energy of each graph: `DOUBT` for each contradicted press or cue, and the surprise of its cues."""
        surprise = self._surprise[np.arange(classes.shape[1]), classes]
        doubts = DOUBT * np.isinf(surprise).sum(axis=1)
        for button, lit, has_lit, has_opened in self._presses:
            allowed = can_light(parents[:, button], lit)
            doubts += DOUBT * (allowed != has_lit)
            if has_lit:
                doubts += DOUBT * ((goals == button) != has_opened)
        return doubts, np.where(np.isinf(surprise), 0.0, surprise).sum(axis=1)


def _draw_graph(config: ButtonsConfig, count: int, rng: np.random.Generator) -> tuple[Edges, int]:
    """Sample a graph of the room configuration for a number of buttons."""
    most: Any = config.graph.max_parents
    if isinstance(most, Between):
        most = int(rng.integers(int(most.low), int(most.high), endpoint=True))
    return sample_relabelled(dataclasses.replace(config.graph, max_parents=most), count, rng, config.goal)


def _exchange(parents: NDArray[np.uint64], goals: NDArray[np.int64], first: NDArray[np.int64],
              second: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Exchange the labels of two buttons in each graph, as rows of parents and as bits in all rows."""
    rows = np.arange(len(parents))
    moved = parents.copy()
    moved[rows, first], moved[rows, second] = parents[rows, second], parents[rows, first]
    low, high = first.astype(np.uint64)[:, None], second.astype(np.uint64)[:, None]
    differ = (moved >> low ^ moved >> high) & np.uint64(1)
    moved ^= differ << low | differ << high
    others = np.where(goals == first, second, np.where(goals == second, first, goals))
    return moved, others
