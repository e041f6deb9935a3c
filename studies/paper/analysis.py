"""The experiments of the 2019 paper, replicated: its claims, its figures, and a rerun of the published program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.agents.registry import DEFAULT_RECIPE, KERAS_RL
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.statistics import Floats, compute_final, compute_iqm
from hrl_escape.errors import ComparisonError
from hrl_escape.settings import read_record
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.paper.claims import Claim, compare_recipes, judge_claims
from studies.paper.measures import (
    Measurement,
    Results,
    get_runs,
    has_settled,
    measure_slope,
    share_of_training,
)
from studies.raw import BINS, RawRun, collect_runs
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Rerun", "Reruns", "analyse", "collect", "compare_reruns", "list_claims"]

LINES = (RawRun,)
collect = collect_runs
TITLES = {"dqn": "DQN", "sarsa": "Deep SARSA", "ddpg": "DDPG", "random": "random"}


@dataclass(frozen=True)
class Rerun:
    """Escapes of the published program in the last fifth of training, its simulation stepped in lockstep.

    Attributes:
        figure: grid of the same experiment.
        agent: label of the same agent there.
        words: experiment, in words.
        shares: share of escaping episodes in the last fifth, one a run.
        note: what else its runs showed; may be empty.
    """

    figure: str
    agent: str
    words: str
    shares: tuple[float, ...]
    note: str = ""


@dataclass(frozen=True)
class Reruns:
    """The published program and this replication, side by side.

    Attributes:
        rerun: of the published program.
        ours: share of escaping episodes in the last fifth, one a run.
    """

    rerun: Rerun
    ours: tuple[float, ...]

    @property
    def gap(self) -> float:
        """Mean of the replication less the program's."""
        return float(np.mean(self.ours) - np.mean(self.rerun.shares))


def list_claims(study: Study) -> list[Claim]:
    """Claims, in the order of the page."""
    return [read_record(Claim, table) for table in study.data["claims"]]


def compare_reruns(reruns: Sequence[Rerun], results: Results) -> list[Reruns]:
    """Compare the published program with the replication, experiment by experiment."""
    return [Reruns(rerun, tuple(map(_compute_late_share, get_runs(results, rerun.figure, rerun.agent))))
            for rerun in reruns]


def _compute_late_share(run: RawRun) -> float:
    late = slice(BINS * 4 // 5, BINS)
    return sum(run.training_successes[late]) / max(sum(run.episodes[late]), 1)


def analyse(study: Study, lines: Sequence[RawRun]) -> Findings:
    """Verdicts on the claims, comparison of settings, and the published program.

    Raises:
        ComparisonError: an agent has no runs.
    """
    results = {grid.name: [run for run in lines if run.grid == grid.name] for grid in study.grids}
    for grid in study.grids:
        planned = {agent.label for agent in grid.agents if not agent.is_reference}
        if missing := planned - {run.agent for run in results[grid.name]}:
            raise ComparisonError(f"{grid.name} has no run of {', '.join(sorted(missing))}: run it again without "
                                  "--from-raw")
    findings = judge_claims(list_claims(study), results)
    reruns = compare_reruns([read_record(Rerun, table) for table in study.data["reruns"]], results)
    cells = dict.fromkeys((name, run.agent) for name, own in results.items() for run in own)
    return Findings(
        SimpleNamespace(claims=findings, settings=compare_recipes(results), reruns=reruns,
                        runs=min(len(get_runs(results, *cell)) for cell in cells)),
        {"claims": make_table(["", "the paper says", "measured", "2019 settings", "default settings", "verdict",
                               "published program, rerun"], [
            [number, found.claim.says, f"{found.claim.measured}: {found.claim.holds.words}",
             _list_estimates(found.paper, found.claim.unit), _list_estimates(found.corrected, found.claim.unit),
             _list_verdicts(found.verdicts), found.claim.rerun] for number, found in enumerate(findings, 1)]),
         "verdicts": make_table(["", "the paper says", "verdict"], [
             [number, found.claim.says, _list_verdicts(found.verdicts)] for number, found in enumerate(findings, 1)]),
         "reruns": make_table(["experiment", "published program", "replicated, mean", "difference", "note"], [
             [own.rerun.words.replace("meta-actions", "options"),
              ", ".join(f"{share:.2f}" for share in own.rerun.shares),
              f"{np.mean(own.ours):.2f} ({min(own.ours):.2f} to {max(own.ours):.2f})", f"{own.gap:+.2f}",
              own.rerun.note] for own in reruns]),
         "runs": make_table(["figure", "agent", "final score", "slope", "settled", "success rate in training"], [
             _make_row(results, *cell) for cell in cells])},
        {name: (lambda theme, runs=runs: draw_figure(runs, theme)) for name, runs in results.items()})


def _make_row(results: Results, figure: str, agent: str) -> list[str]:
    runs = get_runs(results, figure, agent)
    final = Measurement(tuple(compute_final(run.at, run.scores, run.budget) for run in runs), compute_iqm).estimate()
    escapes = Measurement(tuple(share_of_training(run, run.training_successes) for run in runs)).estimate()
    return [figure.removeprefix("paper-"), AgentSpec.parse(agent).title, _format(final, "%"),
            _format(measure_slope(runs, False, 0.5).estimate(), "points"),
            f"{sum(map(has_settled, runs))} of {len(runs)}", _format(escapes, "%")]


def _list_verdicts(verdicts: Mapping[str, bool | None]) -> str:
    words = {True: "yes", False: "no", None: "open"}
    kinds = list(verdicts.values())
    if len(set(kinds)) == 1:
        return words[kinds[0]]
    return "<br>".join(f"{TITLES[name]} {words[kind]}" for name, kind in verdicts.items())


def _list_estimates(estimates: Mapping[str, Estimate], unit: str) -> str:
    return "<br>".join(f"{TITLES[name]} {_format(found, unit)}" for name, found in estimates.items())


def _format(found: Estimate, unit: str) -> str:
    sign = "+" if unit == "points" else ""
    value, low, high = (f"{100 * np.round(number, 3) + 0.0:{sign}.0f}"
                        for number in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


# --- figures ---------------------------------------------------------------------------------


def draw_figure(runs: Sequence[RawRun], theme: Theme) -> Figure:
    """Draw the score of training episodes, exploration included, a panel a recipe."""
    colours = dict(zip(TITLES, (theme.lines[1], theme.lines[2], theme.lines[3], theme.muted), strict=True))
    labels = [label for label in dict.fromkeys(run.agent for run in runs) if _get_algorithm(label) in colours]
    panels = [(KERAS_RL, "settings of 2019"), (DEFAULT_RECIPE, "default settings")]

    def draw(grid: Sequence[Axes]) -> None:
        for axes, (recipe, title) in zip(grid, panels, strict=True):
            own = [label for label in labels
                   if _get_algorithm(label) == "random" or AgentSpec.parse(label).recipe == recipe]
            ends = {label: _draw_agent(axes, [run for run in runs if run.agent == label],
                                       colours[_get_algorithm(label)]) for label in own}
            for (label, _), place in zip(sorted(ends.items(), key=lambda end: end[1]), _spread(ends), strict=True):
                algorithm = _get_algorithm(label)
                write_label(axes, 1.03 * runs[0].budget, place, TITLES[algorithm], colours[algorithm])
            axes.set_title(title, loc="left", fontsize=10)
            axes.set(ylim=(-8, 106), xlim=(0, 1.32 * runs[0].budget), ylabel="score, %")
            axes.set_xticks(np.linspace(0, runs[0].budget, 5))
            mark_counts(axes.xaxis)
        grid[-1].set_xlabel(f"{runs[0].axis} of training")

    return make_figure(theme, draw, height=4.6, nrows=2, sharex=True, sharey=True)


def _get_algorithm(label: str) -> str:
    return AgentSpec.parse(label).algorithm


def _spread(ends: Mapping[str, float], least: float = 13) -> list[float]:
    """Heights of labels at the ends of lines, in ascending order and at least so far apart."""
    places: list[float] = []
    for end in sorted(ends.values()):
        places.append(max(end, places[-1] + least) if places else end)
    highest = 100.0
    for number in reversed(range(len(places))):
        places[number] = min(places[number], highest)
        highest = places[number] - least
    return places


def _draw_agent(axes: Axes, runs: Sequence[RawRun], colour: str) -> float:
    """Draw the interquartile mean of the training scores of runs; returns its last value."""
    scores = np.stack([run.training_scores for run in runs])
    at = runs[0].training_at
    if _get_algorithm(runs[0].agent) == "random":
        middle: Floats = np.full(len(at), 100 * float(np.nanmean(scores)))
        axes.plot(at, middle, "--", color=colour, linewidth=1.6)
        return float(middle[-1])
    known = np.where(np.isfinite(scores), scores, np.nan)
    seen = np.isfinite(known).any(axis=0)
    middle = np.full(len(at), np.nan)
    middle[seen] = 100 * np.array([compute_iqm([column[np.isfinite(column)]]) for column in known[:, seen].T])
    axes.plot(at, middle, color=colour, linewidth=2.2)
    return float(middle[seen][-1])
