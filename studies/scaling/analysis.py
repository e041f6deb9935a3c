"""From 2 to 20 buttons: who escapes and when, what makes rooms difficult, and how soon the graph is known."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.reporting.figures import choose_styles
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError, ConfigError, UnknownNameError
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import GridArgs
from studies.scaling.difficulty import tell_difficulty
from studies.scaling.findings import advise_sizes, tell_certainty, tell_replication, tell_sizes
from studies.scaling.followed_runs import FollowedRuns, Pick, count_spared, follow_runs, list_bins
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import (
    AGENTS,
    BAR,
    BAR_AGENT,
    BAR_RUNS,
    FRESH,
    GRAPHS,
    MAX_PARENTS,
    NEAR_BEST,
    RULES,
    SIZES,
    STUDY_PARTS,
    TOLD,
    TOLD_TASKS,
    run_scaling,
)
from studies.scaling.told import HOLDS, advise_told, list_told_rows, tell_told
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "analyse", "draw_escapes", "draw_structure", "measure"]

LINES = (ScalingRun,)
_KNOWN = (*AGENTS, *(spec.label for spec in TOLD))
_COLOURS = {agent: look.colour for agent, look in zip(AGENTS, choose_styles(list(map(AgentSpec, AGENTS))), strict=True)}
MARKERS = dict(zip(AGENTS, "od^svPX*x", strict=True))


@dataclasses.dataclass(frozen=True)
class Args(GridArgs):
    """Options of the scaling study."""

    first_seed: int = 0
    """Lowest seed of rooms and training; the page holds those from 100 on against the published ones."""
    runs: int = 2
    """Runs of each agent in each kind of room, each in a room of its own."""
    primitives: int = 20_000
    """Training budget of a run."""
    minutes: float = 40.0
    """Begin no run after so long; the page says what was run."""
    parts: tuple[str, ...] = STUDY_PARTS
    """Parts to run: bar, told, agents."""
    agents: tuple[str, ...] = AGENTS
    """Agents of the part agents."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Run the parts that are asked for, as far as the time goes.

    Raises:
        ComparisonError: no run is finished.
        ConfigError: runs that new ones would join had another budget.
    """
    for what, names, known in (("part", args.parts, STUDY_PARTS), ("agent", args.agents, AGENTS)):
        for name in names:
            if name not in known:
                raise UnknownNameError(f"{what} of the scaling study", name, known)
    there: list[ScalingRun] = store.load()
    for run in there:
        if run.budget != args.primitives:
            raise ConfigError("primitives", args.primitives, f"the runs in {store.path}, which new ones join, have "
                              f"{run.budget}. Choose another --docs")
    made = run_scaling(args.out / study.name, args.runs, args.primitives, args.workers, args.minutes,
                       first_seed=args.first_seed, parts=args.parts, agents=args.agents)
    if not there and not made:
        raise ComparisonError(f"no run is finished after {args.minutes:g} minutes: raise --minutes")
    store.add(made)


def analyse(study: Study, lines: Sequence[ScalingRun]) -> Page:
    """Sentences, tables and figures of runs; those from seed `FRESH` on are held against the others.

    Raises:
        ComparisonError: none of the runs is of an agent of `AGENTS`.
        UnknownNameError: a run is of an agent that the study has not.
    """
    for name in {run.agent for run in lines} - set(_KNOWN):
        raise UnknownNameError("agent of the scaling study", name, _KNOWN)
    everything, fresh = ([run for run in sorted(lines, key=lambda run: run.place) if (run.run >= FRESH) == is_fresh]
                         for is_fresh in (False, True))
    results = [run for run in everything if run.agent in AGENTS]
    if not results:
        raise ComparisonError("no run of this study's agents is finished: run it with the part agents")
    return Page({
        "budget": _get_budget(results), "trials": len({run.place for run in everything}),
        "hours": sum(run.seconds for run in everything) / 3600, "NEAR_BEST": NEAR_BEST, "MAX_PARENTS": MAX_PARENTS,
        "BAR_RUNS": BAR_RUNS, "GRAPHS": GRAPHS, "HOLDS": HOLDS, "bar_agent": BAR_AGENT.removeprefix("smdp-"),
        "sentences": [*tell_sizes(results), *tell_difficulty(results, np.random.default_rng(0))],
        "advice": " ".join(filter(None, [advise_sizes(results), advise_told(everything)])),
        "certainty": tell_certainty(results), "bar": _tabulate_bar(results), "again": tell_replication(fresh, results),
        "escapes": _tabulate(results, _get_escape), "by_edges": _tabulate_bins(results, "edges"),
        "by_depth": _tabulate_bins(results, "depth"),
        "near": _tabulate([run for run in results if run.agent != "random-options"], lambda run: run.near_best),
        "graphs": _tabulate_structure(results), "told": tell_told(everything), "told_rows": list_told_rows(everything),
        "told_room": TOLD_TASKS[0], "counts": {agent: sum(run.agent == agent for run in results) for agent in AGENTS},
        "commands": _list_options(everything, _get_budget(results)),
    }, {"scaling": draw_escapes(results), "scaling-structure": draw_structure(results)})


# --- tables ----------------------------------------------------------------------------------


def _list_options(everything: Sequence[ScalingRun], budget: int) -> list[str]:
    """Options of commands that make at least these runs, one where all parts have as many."""
    agents = [run for run in everything if run.agent in AGENTS and run.task not in BAR]
    told = [run for run in everything if run.agent not in AGENTS]
    counts = {parts: 1 + max(run.run for run in runs)
              for parts, runs in (("bar agents", agents), ("told", told)) if runs}
    if len(set(counts.values())) < 2:
        return [f"--runs {max(counts.values(), default=1)} --primitives {budget}"]
    return [f"--parts {parts} --runs {runs} --primitives {budget}" for parts, runs in counts.items()]


def _tabulate_bar(results: Sequence[ScalingRun]) -> str:
    rows = []
    for task in BAR:
        own = [run for run in results if (run.task, run.agent) == (task, BAR_AGENT) and run.run < BAR_RUNS]
        if not own:
            continue
        escapes = [run.first_escape for run in own if run.first_escape is not None]
        last = [np.array([run.structure[-1][measure] if run.structure else 0.0 for run in own]) for measure in (1, 2)]
        rows.append([f"{task.buttons} buttons, {task.graph}, {task.rule}", len(own), len(escapes),
                     f"{np.median(escapes):,.0f}" if escapes else "never",
                     *(f"{values.mean():.3f} ({values.min():.2f})" for values in last),
                     f"{sum(run.near_best is not None for run in own)} of {len(own)}"])
    return make_table(["room", "runs", "escape within the budget", "first escape, median", "precision, mean (least)",
                       "recall, mean (least)", "near the best"], rows)


def _tabulate(results: Sequence[ScalingRun], pick: Pick) -> str:
    budget = _get_budget(results)
    rows: list[list[Any]] = []
    for rule, agent in itertools.product(RULES, AGENTS):
        followed = [_follow(results, rule, agent, size, pick, budget) for size in SIZES]
        if any(followed):
            rows.append([rule, agent, *(runs or "—" for runs in followed)])
    return make_table(["rule", "agent", *SIZES], rows)


def _get_escape(run: ScalingRun) -> int | None:
    return run.first_escape


def _get_budget(results: Sequence[ScalingRun]) -> int:
    return max(result.budget for result in results)


def _follow(results: Sequence[ScalingRun], rule: str, agent: str, size: int, pick: Pick, budget: int
            ) -> FollowedRuns | None:
    own = [run for run in results if (run.rule, run.agent, run.buttons) == (rule, agent, size)]
    return follow_runs(own, count_spared(results, rule, agent, size), budget, pick)


def _tabulate_bins(results: Sequence[ScalingRun], measure: Literal["edges", "depth"]) -> str:
    bins = list_bins(results, measure)
    rows: list[list[Any]] = []
    for rule, agent in itertools.product(RULES, AGENTS):
        own = [run for run in results if (run.rule, run.agent) == (rule, agent)]
        inside = [[run for run in own if least <= getattr(run, measure) <= most] for least, most in bins]
        if own:
            rows.append([rule, agent, *(follow_runs(runs, 0, _get_budget(results), _get_escape) or "—"
                                        for runs in inside)])
    return make_table(["rule", "agent", *(f"{least} to {most}" if least < most else least for least, most in bins)],
                      rows)


def _tabulate_structure(results: Sequence[ScalingRun]) -> str:
    rows = []
    for rule, agent in itertools.product(RULES, AGENTS):
        if any(run.agent == agent and run.structure for run in results):
            cells = []
            for size in SIZES:
                own = [run.structure[-1] for run in results
                       if (run.rule, run.agent, run.buttons) == (rule, agent, size) and run.structure]
                ends = [np.mean([end[measure] for end in own]) for measure in (1, 2)] if own else []
                cells.append(" / ".join(f"{end:.2f}" for end in ends) or "—")
            rows.append([rule, agent, *cells])
    return make_table(["rule", "agent", *SIZES], rows)


# --- figures ---------------------------------------------------------------------------------


def draw_escapes(results: Sequence[ScalingRun]) -> Figure:
    """Primitives to the first escape against buttons: a column a graph, a row a rule; dots are runs."""
    budget = _get_budget(results)
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(10.4, 6.2), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(len(RULES), len(GRAPHS), sharex=True, sharey=True, squeeze=False)
        for row, rule in zip(panels, RULES, strict=True):
            for axes, graph in zip(row, GRAPHS, strict=True):
                here = [result for result in results if (result.graph, result.rule) == (graph, rule)]
                for number, agent in enumerate(AGENTS):
                    own = [result for result in here if result.agent == agent and result.first_escape is not None]
                    followed = [_follow(here, rule, agent, size, _get_escape, budget) for size in SIZES]
                    middle = [np.nan if runs is None or runs.median is None else runs.median for runs in followed]
                    style = {"color": _COLOURS[agent], "marker": MARKERS[agent]}
                    axes.plot(SIZES, middle, linewidth=1.5, markersize=5, label=agent, **style)
                    shift = 0.08 * (number - (len(AGENTS) - 1) / 2)
                    dots = [(r.buttons + shift, r.first_escape) for r in own]
                    axes.scatter(*zip(*dots, strict=True) if dots else ([], []), s=7, alpha=0.5, **style)
                for size in SIZES:
                    failed = [agent for agent in AGENTS
                              if any((r.agent, r.buttons, r.first_escape) == (agent, size, None) for r in here)]
                    for place, agent in enumerate(failed):
                        axes.plot(size, 1.05 + 0.055 * place, color=_COLOURS[agent], marker=MARKERS[agent],
                                  markersize=4, transform=axes.get_xaxis_transform(), clip_on=False)
                axes.axhline(budget, color=palette.MUTED, linestyle=":", linewidth=1)
                axes.set_title(f"{graph}, {rule}", fontsize=9, color=palette.INK, loc="left", pad=48)
                axes.set_yscale("log")
                finish_axes(axes)
                axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0f}"))
                axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        least = min((r.first_escape for r in results if r.first_escape is not None), default=1)
        panels[0, 0].set_ylim(0.7 * least, 1.05 * budget)
        for axes in panels[-1]:
            axes.set_xlabel("buttons", color=palette.INK)
            axes.set_xlim(0.5, SIZES[-1] + 1.5)
            axes.set_xticks(SIZES)
        for axes in panels[:, 0]:
            axes.set_ylabel("primitives to the\nfirst escape", color=palette.INK)
            axes.text(-0.03, 1.03, f"not within\n{budget:,}", transform=axes.transAxes, ha="right", va="bottom",
                      color=palette.MUTED, fontsize=8)
        panels[0, -1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    return figure


def draw_structure(results: Sequence[ScalingRun]) -> Figure:
    """Precision and recall of the recovered graph against primitives, means over runs and graphs, 10 and 20 buttons."""
    agents = [agent for agent in AGENTS if any(result.agent == agent and result.structure for result in results)]
    columns = [(rule, buttons) for rule in RULES for buttons in (10, 20)]
    budget = _get_budget(results)
    grid = np.linspace(0, budget, 201)
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(10.4, 2.9), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, len(columns), sharey=True)
        for axes, (rule, buttons) in zip(panels, columns, strict=True):
            for agent in agents:
                here = [r for r in results if (r.rule, r.buttons, r.agent) == (rule, buttons, agent) and r.edges]
                for measure, dash in ((1, "--"), (2, "-")):
                    curves = [_sample(result, measure, grid) for result in here]
                    middle = np.mean(curves, axis=0) if curves else np.full(len(grid), np.nan)
                    label = f"{agent}, {'precision' if measure == 1 else 'recall'}"
                    axes.plot(grid, middle, dash, color=_COLOURS[agent], linewidth=1.6, label=label)
            axes.set_title(f"{buttons} buttons, {rule}", fontsize=9, color=palette.INK, loc="left")
            axes.set_xlabel("primitives", color=palette.INK)
            axes.set_ylim(-0.04, 1.04)
            finish_axes(axes)
            axes.set_xticks([0, budget // 20_000 * 10_000 or budget // 2, budget // 10_000 * 10_000 or budget])
        panels[0].set_ylabel("precision or recall", color=palette.INK)
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _sample(result: ScalingRun, measure: int, grid: np.ndarray) -> np.ndarray:
    """A measure of the graph as a step function; it stays as it was when the run was over."""
    at = [step[0] for step in result.structure]
    values = np.array([0.0, *(step[measure] for step in result.structure)])
    return values[np.searchsorted(at, grid, side="right")]
