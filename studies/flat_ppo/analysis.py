"""The fall of flat PPO: time in corners and entropy beside first escapes, and what each remedy changes against `ppo`.

Runs of the same seed are pairs. First escapes are compared as ratios, those that never came counting as the budget;
each table of comparisons is one family (Holm), and all tests are by flipped signs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from hrl_escape.names import join_words
from studies.figures import FIGURE_STYLE, finish_axes
from studies.flat import (
    TENTHS,
    FlatArgs,
    FlatJob,
    FlatLearner,
    FlatRun,
    count_untrained,
    list_learners,
    measure_flat_runs,
)
from studies.page import make_table
from studies.statistics import Difference, compare_signs
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "advise", "analyse", "compare", "measure", "tell_fall", "tell_late", "tell_learning",
           "tell_remedies", "tell_untrained"]

LINES = (FlatRun,)
Args = FlatArgs
FULL = math.log(6)
"""Largest entropy of a policy over the six primitives, nats."""


def measure(study: Study, args: FlatArgs, store: Store) -> None:
    """Make the runs that are missing, seed by seed."""
    data, room = study.data, generate(get_preset(study.data["room"]), 0)
    seeds = range(args.first_seed, args.first_seed + (args.runs or data["runs"]))
    measure_flat_runs(store, [FlatJob(learner, room, seed, data["budget"], data["eval_every"])
                              for seed in seeds for learner in list_learners(study, args)], args.minutes)


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


# --- words -----------------------------------------------------------------------------------


def tell_fall(lines: Sequence[FlatRun], plain: str, chance: str) -> str:
    """The finding: does PPO escape later than a policy that never learns, and is it in corners at full entropy?"""
    if chance not in (escape := compare(lines, [chance], plain, read_escape)):
        return f"Nothing is concluded from fewer than {LEAST_RUNS} pairs of runs."
    corners = compare(lines, [chance], plain, read_corners)[chance]
    share = {label: float(np.mean([read_corners(run) for run in lines if run.agent == label]))
             for label in (plain, chance)}
    entropy = float(np.mean([run.entropy for run in lines if run.agent == plain])) / FULL
    where = (f"spends {share[plain]:.0%} of its time in corners, where a policy that never learns spends "
             f"{share[chance]:.0%}")
    factor, ends = math.exp(-escape[chance].mean), sorted(math.exp(-end) for end in escape[chance][1:3])
    price = f"{factor:.1f} times the primitives of chance ({ends[0]:.1f} to {ends[1]:.1f})"
    if not escape[chance].sign and corners.sign < 0:
        return (f"Flat PPO drifts into corners: `{plain}` {where}, at {entropy:.0%} of the largest entropy; that its "
                f"first escape comes later is not shown: it takes {price}.")
    if escape[chance].sign >= 0:
        return (f"No fall is shown: until its first escape `{plain}` takes {price}; it {where}."
                if not escape[chance].sign else
                f"`{plain}` beats chance: until its first escape it takes {price}; it {where}.")
    if corners.sign < 0:
        return (f"Flat PPO falls below chance because it drifts into corners: `{plain}` {where}, at {entropy:.0%} of "
                f"the largest entropy, and until its first escape it takes {price}.")
    return f"Flat PPO falls below chance, and not by corners: until its first escape it takes {price}; it {where}."


def find_untrained(lines: Sequence[FlatRun], learners: Mapping[str, FlatLearner]) -> dict[str, tuple[int, int]]:
    """Label -> latest first escape and primitives before the first update, of those all of whose escapes come before.

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


def tell_untrained(lines: Sequence[FlatRun], learners: Mapping[str, FlatLearner], chances: Mapping[int, str]) -> str:
    """Sentences on learners whose first escapes all come before their first update; empty where there are none.

    Args:
        lines: all runs.
        learners: by label.
        chances: primitives that an action is repeated for -> label of the policy that never learns with as many.
    """
    controls = list(chances.values())
    found = find_untrained(lines, learners)
    said = []
    for escapes, labels in group_alike(lines, found).items():
        if all(label in controls for label in labels):
            continue
        latest, update = found[labels[0]]
        repeat, who = learners[labels[0]].repeat, join_words([f"`{label}`" for label in labels])
        alike = f", the same in {'both' if len(labels) == 2 else 'all'} run by run," if len(labels) > 1 else ""
        said.append(f"The {len(escapes)} first escapes of {who}{alike} come within {latest:,} primitives, and the "
                    f"first update only after {update:,}: they are those of random moves"
                    + (f", each repeated {repeat} times" if repeat > 1 else "") + ", and not of learning.")
        if repeat not in chances:
            said.append(f"Chance with {repeat} repeats was not run.")
    return " ".join(said)


def tell_late(lines: Sequence[FlatRun], learners: Mapping[str, FlatLearner], chances: Mapping[int, str]) -> list[str]:
    """A sentence a control: do its learners escape more often in the last half of training than it does?

    Args:
        lines: all runs.
        learners: by label.
        chances: as of `tell_untrained`.
    """
    said = []
    for repeat, control in chances.items():
        twins = [label for label, learner in learners.items() if learner.repeat == repeat and label != control]
        found = compare(lines, twins, control, read_late)
        share = {label: float(np.mean([read_late(run) for run in lines if run.agent == label]))
                 for label in (control, *found)}
        words = {sign: [f"`{label}` ({share[label]:.0%}; {test.mean:+.2f}, {test.low:+.2f} to {test.high:+.2f})"
                        for label, test in found.items() if test.sign == sign] for sign in (1, -1, 0)}
        told = [f"{kind} {join_words(words[sign])}" for sign, kind in
                ((1, "more often"), (-1, "less often"), (0, "no difference is shown for")) if words[sign]]
        if told:
            said.append(f"In the last half of training `{control}` escapes in {share[control]:.0%} of its episodes; "
                        f"{'; '.join(told)}.")
    return said


def group_alike(lines: Sequence[FlatRun], labels: Iterable[str]) -> dict[tuple[tuple[int, int | None], ...], list[str]]:
    """Labels by their first escapes, seed by seed."""
    groups: dict[tuple[tuple[int, int | None], ...], list[str]] = {}
    for label in labels:
        own = tuple(sorted((run.seed, run.first_escape) for run in lines if run.agent == label))
        groups.setdefault(own, []).append(label)
    return groups


def tell_remedies(lines: Sequence[FlatRun], remedies: Sequence[str], plain: str, chance: str,
                  untrained: Collection[str] = ()) -> list[str]:
    """A sentence a remedy: time in corners and first escape against the plain learner's, and whether chance is beaten.

    Args:
        lines: all runs.
        remedies: labels.
        plain: label of the learner without them.
        chance: label of the policy that never learns.
        untrained: labels whose first escapes come before they learn.
    """
    corners = compare(lines, remedies, plain, read_corners)
    escapes = compare(lines, remedies, plain, read_escape)
    beyond = compare(lines, remedies, chance, read_escape)
    told = []
    for label in corners:
        where, when, over = corners[label], escapes[label], beyond.get(label)
        keeps = {-1: "keeps it out of corners", 1: "drives it into corners",
                 0: "is not shown to change its time in corners"}[where.sign]
        factor, ends = math.exp(when.mean), (math.exp(when.low), math.exp(when.high))
        speed = {-1: "comes sooner", 1: "comes later", 0: "is not shown to come sooner or later"}[when.sign]
        sooner = ("; all of its first escapes come before the first update" if label in untrained else
                  "; it beats chance")
        chances = "" if over is None else {-1: sooner, 1: "; it stays behind chance",
                                           0: "; it is not told apart from chance"}[over.sign]
        told.append(f"`{label}` {keeps} ({where.mean:+.2f}, {where.low:+.2f} to {where.high:+.2f}), and its first "
                    f"escape {speed} ({factor:.2f} times the primitives, {ends[0]:.2f} to {ends[1]:.2f}){chances}.")
    return told


def advise(lines: Sequence[FlatRun], remedies: Sequence[str], plain: str, untrained: Collection[str] = ()) -> str:
    """Advice to a user: remedies that bring the first escape sooner, and those that only keep out of corners.

    Args:
        lines: all runs.
        remedies: labels.
        plain: label of the learner without them.
        untrained: labels whose first escapes come before they learn.
    """
    corners, escapes = (compare(lines, remedies, plain, read) for read in (read_corners, read_escape))
    sooner = {label: f"`{label}`" for label, found in escapes.items() if found.sign < 0}
    kept = [f"`{label}`" for label, found in corners.items() if found.sign < 0 and label not in sooner]
    said = "Watch where your agent spends its time before the first reward"
    learned, early = ([name for label, name in sooner.items() if (label in untrained) == is_early]
                      for is_early in (False, True))
    if learned:
        said += f", and begin with {join_words(learned, 'or')}: the first escape comes sooner"
    if early:
        said += (f"{'; ' if learned else ', and '}try {join_words(early, 'or')}: the first escape comes sooner, "
                 "before anything is learned")
    if kept:
        said += (f"; {join_words(kept)} {'keeps' if len(kept) == 1 else 'keep'} it out of corners but "
                 f"{'is' if len(kept) == 1 else 'are'} not shown to bring the first escape sooner")
    return f"{said}{'' if sooner or kept else '; none of the remedies tried here is shown to help'}."


def tell_learning(lines: Sequence[FlatRun], learners: Sequence[str]) -> str:
    """Worth of the greedy policies in the end, by count: an escape by luck in training is not learning."""
    counts = {label: (sum(run.efficiency > 0 for run in own), len(own)) for label in learners
              if (own := [run for run in lines if run.agent == label])}
    some = [f"`{label}` in {hits} of {runs} runs" for label, (hits, runs) in counts.items() if hits]
    if not some:
        return ("No greedy policy escapes at the end of any run: what helps here is exploring, and nothing was learned "
                "yet.")
    rest = "" if len(some) == len(counts) else "; those of the others in none"
    return f"Greedy policies that escape at the end: {join_words(some)}{rest}."


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[FlatRun]) -> Page:
    """Sentences, table and figure.

    Raises:
        ComparisonError: there are no runs.
    """
    if not lines:
        raise ComparisonError("there are no runs to tell of")
    data = study.data
    lines = sorted(lines, key=lambda run: run.place)
    labels = [table["label"] for table in data["learners"] if any(run.agent == table["label"] for run in lines)]
    plain, chance = data["plain"], data["chances"][0]
    remedies = [label for label in labels if label not in (plain, *data["chances"])]
    learners = {learner.label: learner for learner in list_learners(study, FlatArgs(agents=tuple(labels)))}
    chances = {learners[label].repeat: label for label in data["chances"] if label in learners}
    untrained = find_untrained(lines, learners)
    headline, told = tell_fall(lines, plain, chance), tell_remedies(lines, remedies, plain, chance, untrained)
    early, late = tell_untrained(lines, learners, chances), tell_late(lines, learners, chances)
    learning = tell_learning(lines, [label for label in labels if label not in data["chances"]])
    return Page({
        "headline": headline, "told": told, "early": early, "late": late,
        "advice": advise(lines, remedies, plain, untrained), "learning": learning, "budget": lines[0].budget,
        "runs": min(sum(run.agent == label for run in lines) for label in labels),
        "table": make_table(["learner", "runs", "first escape, median", "never", "in corners", "share of full entropy",
                             "escapes in training, last half", "efficiency at the end"],
                            [_describe(label, [run for run in lines if run.agent == label]) for label in labels]),
        "settings": {table["label"]: table for table in data["learners"]},
    }, {"flat-ppo": draw(lines, labels)}, [headline, *told, *late, learning, *filter(None, [early])])


def _describe(label: str, runs: Sequence[FlatRun]) -> list[Any]:
    late = [read_late(run) for run in runs if any(share is not None for share in run.escapes[TENTHS // 2:])]
    first = np.median([min(run.first_escape or run.budget, run.budget) for run in runs])
    return [f"`{label}`", len(runs), f"{first:,.0f}",
            sum(run.first_escape is None for run in runs), f"{np.mean([read_corners(run) for run in runs]):.2f}",
            f"{np.mean([run.entropy for run in runs]) / FULL:.2f}", f"{np.mean(late):.2f}" if late else "-",
            f"{np.mean([run.efficiency for run in runs]):.2f}"]


def draw(lines: Sequence[FlatRun], labels: Sequence[str]) -> Figure:
    """Time in corners along the run, mean over runs, and the first escapes of all runs."""
    colours: Mapping[str, str] = dict(zip(labels, (palette.MUTED, *palette.LINES), strict=False))
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 3.4), facecolor=palette.BACKGROUND, layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
        for at, label in enumerate(labels[::-1]):
            own = [run for run in lines if run.agent == label]
            middles = (np.arange(TENTHS) + 0.5) / TENTHS * own[0].budget
            left.plot(middles, np.mean([run.corners for run in own], axis=0), color=colours[label], linewidth=1.8)
            escaped = [run.first_escape for run in own if run.first_escape is not None]
            right.plot(escaped, [at] * len(escaped), "o", markersize=5, alpha=0.6, color=colours[label],
                       markeredgewidth=0)
            never = len(own) - len(escaped)
            if never:
                right.plot(1.15 * own[0].budget, at, "x", markersize=6, color=colours[label])
                right.text(1.25 * own[0].budget, at, f"{never} never", va="center", color=palette.MUTED)
        finish_axes(left)
        left.set(xlabel="primitives of training", ylabel="share of time in corners", ylim=(0, None))
        finish_axes(right)
        right.set_xscale("log")
        right.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        right.set_yticks(range(len(labels)), labels[::-1])
        for tick, label in zip(right.get_yticklabels(), labels[::-1], strict=True):
            tick.set_color(colours[label])
        right.set(xlabel="primitives to the first escape", xlim=(None, 2.2 * lines[0].budget))
    return figure
