"""Flat PPO: time in corners, entropy and first escapes, and what each change of PPO does to them.

Runs of the same seed are pairs. First escapes are compared as ratios, those that never came counting as the budget;
each table of comparisons is one family (Holm), and all tests are by flipped signs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import ComparisonError
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.flat import TENTHS, FlatLearner, FlatRun, count_untrained, read_learner
from studies.statistics import Difference, compare_signs
from studies.study import Findings, Study
from studies.tables import make_table
from studies.titles import find_title

__all__ = ["LINES", "analyse", "compare", "find_untrained", "read_corners", "read_escape",
           "read_late"]

LINES = (FlatRun,)
FULL = math.log(6)
"""Largest entropy of a policy over the six primitives, nats."""


# --- comparisons -----------------------------------------------------------------------------


def compare(lines: Sequence[FlatRun], others: Sequence[str], plain: str, read: Callable[[FlatRun], float]
            ) -> dict[str, Difference]:
    """Differences of some learners from the plain one in a number of each run, as one family (Holm)."""
    base = {run.seed: read(run) for run in lines if run.agent == plain}
    gains = {label: np.array([read(run) - base[run.seed] for run in lines if run.agent == label and run.seed in base])
             for label in others}
    return compare_signs({label: own for label, own in gains.items() if len(own) >= LEAST_RUNS})


def read_escape(run: FlatRun) -> float:
    """Logarithm of the primitives to the first escape, at most the budget."""
    return math.log(min(run.first_escape or run.budget, run.budget))


def read_corners(run: FlatRun) -> float:
    """Share of the run spent in corners."""
    return float(np.mean(run.corners))


def read_late(run: FlatRun) -> float:
    """Share of episodes in the last half of the run that end in an escape."""
    late = [share for share in run.escapes[TENTHS // 2:] if share is not None]
    return float(np.mean(late)) if late else 0.0


def find_untrained(lines: Sequence[FlatRun], learners: Mapping[str, FlatLearner]) -> dict[str, tuple[int, int]]:
    """Latest first escape and primitives before the first update, of learners that escape before it in all runs.

    Args:
        lines: all runs.
        learners: by label.
    """
    found = {}
    for label, learner in learners.items():
        ends = [run.first_escape for run in lines if run.agent == label]
        known = [end for end in ends if end is not None]
        if known and len(known) == len(ends) and max(known) <= count_untrained(learner):
            found[label] = max(known), count_untrained(learner)
    return found


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[FlatRun]) -> Findings:
    """Differences from plain PPO and from untrained policies, a table and the figure.

    Raises:
        ComparisonError: there are no runs.
    """
    if not lines:
        raise ComparisonError("this study has no runs")
    data = study.data
    lines = sorted(lines, key=lambda run: run.place)
    runs = {table["label"]: own for table in data["learners"]
            if (own := [run for run in lines if run.agent == table["label"]])}
    plain, chance = data["plain"], data["chances"][0]
    remedies = [label for label in runs if label not in (plain, *data["chances"])]
    learners = {table["label"]: read_learner(table) for table in data["learners"] if table["label"] in runs}
    late = {label: found for control in data["chances"] for label, found in compare(
        lines, [label for label, learner in learners.items()
                if learner.repeat == learners[control].repeat and label != control], control, read_late).items()}
    return Findings(SimpleNamespace(
        budget=lines[0].budget,
        corners={label: float(np.mean(list(map(read_corners, own)))) for label, own in runs.items()},
        chance_escape=take_exponent(compare(lines, [chance], plain, read_escape).get(chance), -1),
        chance_corners=compare(lines, [chance], plain, read_corners).get(chance),
        remedy_corners=compare(lines, remedies, plain, read_corners),
        remedy_escapes={label: take_exponent(found) for label, found in
                        compare(lines, remedies, plain, read_escape).items()},
        untrained=find_untrained(lines, learners), late=late,
        greedy={label: sum(run.efficiency > 0 for run in own) for label, own in runs.items()
                if label not in data["chances"]}), {
            "flat_ppo": make_table(["learner", "label", "runs", "first escape, median", "never", "time in corners",
                                    "share of full entropy", "escapes in training, last half", "efficiency at the end"],
                                   [_describe(label, own) for label, own in runs.items()])},
        {"flat-ppo": partial(draw, runs)})


def take_exponent(found: Difference | None, sign: int = 1) -> Difference | None:
    """Ratio with a difference as its logarithm; with a sign of -1 the inverse ratio."""
    if found is None:
        return None
    low, high = sorted((math.exp(sign * found.low), math.exp(sign * found.high)))
    return Difference(math.exp(sign * found.mean), low, high, found.p)


def _describe(label: str, runs: Sequence[FlatRun]) -> list[Any]:
    late = [read_late(run) for run in runs if any(share is not None for share in run.escapes[TENTHS // 2:])]
    first = np.median([min(run.first_escape or run.budget, run.budget) for run in runs])
    return [find_title(label), f"`{label}`", len(runs), f"{first:,.0f}",
            sum(run.first_escape is None for run in runs), f"{np.mean([read_corners(run) for run in runs]):.2f}",
            f"{np.mean([run.entropy for run in runs]) / FULL:.2f}", f"{np.mean(late):.2f}" if late else "-",
            f"{np.mean([run.efficiency for run in runs]):.2f}"]


def draw(runs: Mapping[str, Sequence[FlatRun]], theme: Theme) -> Figure:
    """Share of time in corners along the run, mean over runs."""
    shown = {"ppo": (theme.lines[2], 5, 0.295), "ppo, novelty": (theme.lines[3], 9, 0.17),
             "ppo, commitment": (theme.lines[1], 6, 0.092), "ppo, advantages as they are": (theme.lines[0], 4, 0.048),
             "chance": (theme.lines[4], 9, 0.008)}

    def paint(axes: Axes) -> None:
        for label, (colour, tenth, y) in shown.items():
            own = runs[label]
            middles = (np.arange(TENTHS) + 0.5) / TENTHS * own[0].budget
            axes.plot(middles, np.mean([run.corners for run in own], axis=0), color=colour, linewidth=2)
            write_label(axes, tenth / (2 * TENTHS) * own[0].budget, y, find_title(label), colour)
        axes.set(xlabel="primitives of training", ylabel="share of time in corners", ylim=(0, None))
        mark_counts(axes.xaxis)
        axes.set_xticks(np.linspace(0, runs["ppo"][0].budget, 5))

    return make_figure(theme, paint)
