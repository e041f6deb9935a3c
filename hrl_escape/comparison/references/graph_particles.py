"""A sample of the dependency graphs that agree with all presses so far, where there are too many to list.

Sequential Monte Carlo with moves (Chopin 2002; Gilks and Berzuini 2001): graphs are drawn from the schematic, those
that a press contradicts are replaced by others, and all are shaken by Metropolis steps that exchange the labels of two
buttons, under which every graph of the family is as likely as before.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.comparison.references.graph_family import can_light
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import Edges, mask_parents, sample_relabelled
from hrl_escape.errors import UnsupportedError
from hrl_escape.ranges import Between

PARTICLES, SHAKES = 2048, 40
DOUBT = 4.0
"""Cost of a press that a graph does not explain, as a negative logarithm of its likelihood: finite, so that a sample
in which no graph is left can still find one."""


class GraphParticles:
    """Graphs of a schematic, likely in the light of presses.

    Args:
        config: the schematic's puzzle.
        count: number of buttons in the room.
        rng: draws and moves.
        marks: of the room's buttons; none without marks.

    Raises:
        UnsupportedError: marks of several motifs, or sections.

    Attributes:
        parents: uint64 (particles, buttons), the bits of each button's parents.
        goals: int64 (particles,), the button that opens the exit.
    """

    def __init__(self, config: ButtonsConfig, count: int, rng: np.random.Generator, marks: tuple[int, ...] = ()
                 ) -> None:
        if marks and config.marks.motifs > 1:
            raise UnsupportedError(f"marks of {config.marks.motifs} motifs on {count} buttons: smdp-bayes lists the "
                                   "graphs of fewer, and its samples of more know one motif")
        if config.sections.count:
            raise UnsupportedError(f"sections with {count} buttons: smdp-bayes lists the graphs of fewer, and its "
                                   "samples of more do not know where buttons hang")
        self._rng, self._presses = rng, list[tuple[int, int, bool, bool]]()
        self.parents = np.zeros((PARTICLES, count), np.uint64)
        self.goals = np.zeros(PARTICLES, np.int64)
        self._classes = np.zeros((PARTICLES, count), np.int64)
        for number in range(PARTICLES):
            edges, self.goals[number] = _draw_graph(config, count, rng)
            self.parents[number] = mask_parents(edges, count)
            if marks:
                self._classes[number] = config.marks.classify(count, edges, int(self.goals[number]))
        single = [[config.marks.compute_likelihood((mark,), np.array([[own]]))[0] for own in
                   range(config.marks.classes)] for mark in marks] or [[1.0] * config.marks.classes] * count
        with np.errstate(divide="ignore"):
            self._surprise = -np.log(np.array(single))  # (buttons, classes), infinite where a mark cannot be
        self._doubts, self._surprises = self._measure(self.parents, self.goals, self._classes)
        if marks:
            self._resample()
            for _ in range(SHAKES):
                self._shake()

    def learn(self, press: tuple[int, int, bool, bool]) -> None:
        """Take note of a press of an unlit button.

        Args:
            press: button, bits of the buttons that were lit before, whether it lit, and whether the exit opened.
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
        """Draw graphs anew by how well they explain what is known; `counted` is what their number tells already."""
        energy = self._doubts + self._surprises - counted
        likelihood = np.exp(-(energy - energy.min()))
        chosen = self._rng.choice(PARTICLES, PARTICLES, p=likelihood / likelihood.sum())
        for name in ("parents", "goals", "_classes", "_doubts", "_surprises"):
            setattr(self, name, getattr(self, name)[chosen])

    def compute_odds(self, lit: int) -> NDArray[np.float64]:
        """Probability that each button would light if it were pressed, (buttons,).

        Args:
            lit: bits of the buttons that are lit.
        """
        weights = np.exp(-8.0 * self._doubts)
        weights = weights / weights.sum()
        return weights @ can_light(self.parents, lit)

    def _shake(self) -> None:
        """Exchange the labels of two buttons in every graph, where that explains the presses as well."""
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
        """Doubts about every graph, `DOUBT` for each press or mark that cannot be, and the surprise at its marks."""
        surprise = self._surprise[np.arange(classes.shape[1]), classes]
        doubts = DOUBT * np.isinf(surprise).sum(axis=1)
        for button, lit, has_lit, has_opened in self._presses:
            allowed = can_light(parents[:, button], lit)
            doubts += DOUBT * (allowed != has_lit)
            if has_lit:
                doubts += DOUBT * ((goals == button) != has_opened)
        return doubts, np.where(np.isinf(surprise), 0.0, surprise).sum(axis=1)


def _draw_graph(config: ButtonsConfig, count: int, rng: np.random.Generator) -> tuple[Edges, int]:
    """A graph of the schematic for a room with so many buttons."""
    most: Any = config.graph.max_parents
    if isinstance(most, Between):
        most = int(rng.integers(int(most.low), int(most.high), endpoint=True))
    return sample_relabelled(dataclasses.replace(config.graph, max_parents=most), count, rng, config.goal)


def _exchange(parents: NDArray[np.uint64], goals: NDArray[np.int64], first: NDArray[np.int64],
              second: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Each graph with the labels of its two buttons exchanged, as rows of parents and as bits in all rows."""
    rows = np.arange(len(parents))
    moved = parents.copy()
    moved[rows, first], moved[rows, second] = parents[rows, second], parents[rows, first]
    low, high = first.astype(np.uint64)[:, None], second.astype(np.uint64)[:, None]
    differ = (moved >> low ^ moved >> high) & np.uint64(1)
    moved ^= differ << low | differ << high
    others = np.where(goals == first, second, np.where(goals == second, first, goals))
    return moved, others
