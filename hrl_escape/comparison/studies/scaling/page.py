"""Writes docs/results/scaling.md from the raw results of the scaling study: tables, figures, and what was run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.reporting.agent_style import choose_styles
from hrl_escape.comparison.statistics import NEAR_BEST
from hrl_escape.comparison.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.comparison.studies.scaling.difficulty import tell_difficulty
from hrl_escape.comparison.studies.scaling.findings import tell_replication, tell_sizes
from hrl_escape.comparison.studies.scaling.followed_runs import (
    FollowedRuns,
    Pick,
    count_spared,
    follow_runs,
    list_bins,
)
from hrl_escape.comparison.studies.scaling.scaling_runs import ScalingRun
from hrl_escape.comparison.studies.scaling.study import (
    AGENTS,
    BAR,
    BAR_AGENT,
    BAR_RUNS,
    GRAPHS,
    MAX_PARENTS,
    RULES,
    SIZES,
)
from hrl_escape.comparison.studies.scaling.told import make_told_section
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.errors import ComparisonError
from hrl_escape.files import write_text

__all__ = ["draw_escapes", "draw_structure", "write_scaling_page"]

_COMMAND = "hrl-escape experiment scaling"
_COLOURS = {agent: look.colour for agent, look in zip(AGENTS, choose_styles(list(map(AgentSpec, AGENTS))), strict=True)}
MARKERS = dict(zip(AGENTS, "od^svPX*x", strict=True))


def write_scaling_page(everything: Sequence[ScalingRun], docs: Path, fresh: Sequence[ScalingRun] = ()) -> None:
    """Write the page and its figures.

    Args:
        everything: at least one run.
        docs: folder of the page.
        fresh: runs with other seeds and rooms, held against these; may be none.

    Raises:
        ComparisonError: none of the runs is of an agent of `AGENTS`.
        FileWriteError: a file cannot be written.
    """
    results = [run for run in everything if run.agent in AGENTS]
    if not results:
        raise ComparisonError("no run of this study's agents is finished: run it with the part agents")
    save_figure(docs / "figures" / "scaling.svg", draw_escapes(results))
    save_figure(docs / "figures" / "scaling-structure.svg", draw_structure(results))
    write_text(docs / "scaling.md", "\n".join(_write_lines(results, everything, fresh)))


def draw_escapes(results: Sequence[ScalingRun]) -> Figure:
    """Primitives to the first escape against buttons: a column a graph, a row a rule; dots are runs."""
    budget = _get_budget(results)
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(10.4, 5.0), facecolor=palette.BACKGROUND, layout="constrained")
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
                    failed = [r.buttons + shift for r in here if r.agent == agent and r.first_escape is None]
                    axes.scatter(failed, [1.5 * budget] * len(failed), s=14, linewidths=0.8, **style)
                axes.axhline(budget, color=palette.MUTED, linestyle=":", linewidth=1)
                axes.set_title(f"{graph}, {rule}", fontsize=9, color=palette.INK, loc="left")
                axes.set_yscale("log")
                finish_axes(axes)
                axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0f}"))
                axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        for axes in panels[-1]:
            axes.set_xlabel("buttons", color=palette.INK)
            axes.set_xlim(0.5, SIZES[-1] + 1.5)
            axes.set_xticks(SIZES)
        for axes in panels[:, 0]:
            axes.set_ylabel("primitives to the\nfirst escape", color=palette.INK)
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
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _sample(result: ScalingRun, measure: int, grid: np.ndarray) -> np.ndarray:
    """A measure of the graph as a step function; it stays as it was when the run was over."""
    at = [step[0] for step in result.structure]
    values = np.array([0.0, *(step[measure] for step in result.structure)])
    return values[np.searchsorted(at, grid, side="right")]


def _write_lines(results: Sequence[ScalingRun], everything: Sequence[ScalingRun], fresh: Sequence[ScalingRun]
                 ) -> list[str]:
    budget = _get_budget(results)
    trials = {(result.task, result.agent, result.run) for result in everything}
    hours = sum(result.seconds for result in everything) / 3600
    again = tell_replication(fresh, results)
    lines = [
        "# From 2 to 20 buttons", "",
        f"Who still escapes as buttons grow, and how soon the graph of buttons is known? {len(trials)} trials of at "
        f"most {budget:,} primitives each, {hours:.1f} hours of one process in all. The literature's bar (Menashe and "
        "Stone 2015, 2019) is 10 to 20 buttons modelled and solved within 20,000 steps.", "",
        *[f"- {sentence}" for sentence in tell_sizes(results)],
        *[f"- {sentence}" for sentence in tell_difficulty(results, np.random.default_rng(0))], "",
        *_tell_bar(results), "",
        *([f"With training seeds and rooms that nobody had tried before (`{_COMMAND} --parts bar --first-seed 100`):",
           "", *[f"- {line}" for line in again], ""]
          if again else []),
        "## First escape", "",
        "![Primitives to the first escape](figures/scaling.svg)", "",
        "Each line joins the Kaplan-Meier medians over all planned runs, as far as half of these escape; each dot is a "
        "run. The dotted line is the budget; above it are runs that did not escape within it.", "",
        *_make_table(results, _get_escape), "",
        f"Each cell: runs that escaped in training, of all that were planned, over the graphs {', '.join(GRAPHS)}; "
        "mean primitives to the end of the first episode that did, at most the budget (restricted mean, the area under "
        "the Kaplan-Meier curve). An agent that did not escape with fewer buttons (same graph, rule and run) was not "
        "tried with more; it counts as not escaping. — says that none was tried because the study's time "
        "(`--minutes`) was up.", "",
        "## By edges that matter", "",
        *_make_bins_table(results, "edges"), "",
        "The same, by how many edges a press order towards the goal can tell from none, whatever the number of "
        "buttons: these are what must be found out. Rooms that were not tried are left out here.", "",
        "## By depth", "",
        *_make_bins_table(results, "depth"), "",
        "The same, by the most of these edges in a row.", "",
        f"## {NEAR_BEST:.0%} of the best known return", "",
        *_make_table([r for r in results if r.agent != "smdp-random"], lambda run: run.near_best), "",
        f"The same for the first of two evaluations in a row, frozen weights, that scored {NEAR_BEST:g} or more on the "
        "scale from never escaping (0) to the best return known for these options (1). Evaluations are made every "
        "500 primitives from the first escape on.",
        "",
        "## The recovered graph", "",
        "![Precision and recall against primitives](figures/scaling-structure.svg)", "",
        "Means over graphs and runs. Only edges that matter count: those among the ancestors of the goal that no "
        "longer way implies. Where a must be on before b, and b before c, a further edge from a to c changes nothing "
        "that anybody can see.", "",
        *_make_structure_table(results), "",
        *make_told_section(everything),
        "## What was run", "",
        "Rooms are the ladder's: 20 x 20 m (30 x 30 m from 11 buttons on), small buttons anywhere on the walls, "
        f"`max_parents` {MAX_PARENTS} for layered and random graphs, cap of 1,000 primitives; a run has a "
        "room of its own. In the "
        f"two rooms of the bar `{BAR_AGENT.removeprefix('smdp-')}` has up to {BAR_RUNS} runs, in all tables. Agents "
        "choose among the options that press one button and the one to the exit (`include_primitives` off), with "
        "their recommended settings. A trial ends early once its agent is near the best and has the whole graph; that "
        "of `smdp-random`, which learns nothing, with its first escape. `smdp-intra-option-q` is left out: these "
        "options follow plans, so that a primitive inside one says nothing of another, and it does what "
        "`smdp-q-learning` does.",
        "",
        "What the structure learners are told: a press does one thing where all its parents are on and another "
        "where not (`conditions=\"all-on\"`), there are at most two parents, and outcomes are not random. Which bit "
        "belongs to which option, the parents, the exit, what a wrong press does, durations and rewards they find "
        "out.", "",
        *_make_counts(results), "",
        "## Make it again", "",
        "Finished trials are kept; with `--from-raw` the page is written anew from "
        "[raw/scaling.csv](raw/scaling.csv).", "",
        "```console", *_list_commands(everything, budget), "```", "",
    ]  # fmt: skip
    return lines


def _list_commands(everything: Sequence[ScalingRun], budget: int) -> list[str]:
    """Command lines that make at least these runs, one where all parts have as many."""
    agents = [run for run in everything if run.agent in AGENTS and run.task not in BAR]
    told = [run for run in everything if run.agent not in AGENTS]
    counts = {parts: 1 + max(run.run for run in runs)
              for parts, runs in (("bar agents", agents), ("told", told)) if runs}
    if len(set(counts.values())) < 2:
        return [f"{_COMMAND} --runs {max(counts.values(), default=1)} --primitives {budget}"]
    return [f"{_COMMAND} --parts {parts} --runs {runs} --primitives {budget}" for parts, runs in counts.items()]


def _tell_bar(results: Sequence[ScalingRun]) -> list[str]:
    lines = ["| " + " | ".join(("room", "runs", "escape within the budget", "first escape, median",
                                "precision, mean (least)", "recall, mean (least)", "near the best")) + " |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for task in BAR:
        own = [r for r in results if (r.task, r.agent) == (task, BAR_AGENT) and r.run < BAR_RUNS]
        if not own:
            continue
        escapes = [r.first_escape for r in own if r.first_escape is not None]
        last = [np.array([r.structure[-1][measure] if r.structure else 0.0 for r in own]) for measure in (1, 2)]
        shares = " | ".join(f"{values.mean():.3f} ({values.min():.2f})" for values in last)
        near = sum(r.near_best is not None for r in own)
        lines.append(f"| {task.buttons} buttons, {task.graph}, {task.rule} | {len(own)} | {len(escapes)} "
                     f"| {f'{np.median(escapes):,.0f}' if escapes else 'never'} | {shares} | {near} of {len(own)} |")
    return [f"The bar, by `{BAR_AGENT.removeprefix('smdp-')}`, at the end of each trial:", "", *lines]


def _make_table(results: Sequence[ScalingRun], pick: Pick) -> list[str]:
    budget = _get_budget(results)
    lines = ["| rule | agent | " + " | ".join(f"{size}" for size in SIZES) + " |", "|---|---|" + "---|" * len(SIZES)]
    for rule in RULES:
        for agent in AGENTS:
            cells = []
            for size in SIZES:
                cells.append(str(_follow(results, rule, agent, size, pick, budget) or "—"))
            if set(cells) == {"—"}:
                continue
            lines.append(f"| {rule} | {agent} | " + " | ".join(cells) + " |")
    return lines


def _get_escape(run: ScalingRun) -> int | None:
    return run.first_escape


def _get_budget(results: Sequence[ScalingRun]) -> int:
    return max(result.budget for result in results)


def _follow(results: Sequence[ScalingRun], rule: str, agent: str, size: int, pick: Pick, budget: int
            ) -> FollowedRuns | None:
    own = [run for run in results if (run.rule, run.agent, run.buttons) == (rule, agent, size)]
    return follow_runs(own, count_spared(results, rule, agent, size), budget, pick)


def _make_bins_table(results: Sequence[ScalingRun], measure: Literal["edges", "depth"]) -> list[str]:
    bins = list_bins(results, measure)
    names = [f"{least} to {most}" if least < most else f"{least}" for least, most in bins]
    lines = [f"| rule | agent | {' | '.join(names)} |", "|---|---|" + "---|" * len(bins)]
    for rule in RULES:
        for agent in AGENTS:
            own = [run for run in results if (run.rule, run.agent) == (rule, agent)]
            inside = [[run for run in own if least <= getattr(run, measure) <= most] for least, most in bins]
            cells = [str(follow_runs(runs, 0, _get_budget(results), _get_escape) or "—") for runs in inside]
            if own:
                lines.append(f"| {rule} | {agent} | " + " | ".join(cells) + " |")
    return lines


def _make_structure_table(results: Sequence[ScalingRun]) -> list[str]:
    lines = ["| rule | agent | " + " | ".join(f"{size}" for size in SIZES) + " |", "|---|---|" + "---|" * len(SIZES)]
    for rule in RULES:
        for agent in AGENTS:
            if not any(r.agent == agent and r.structure for r in results):
                continue
            cells = []
            for size in SIZES:
                own = [r for r in results if (r.rule, r.agent, r.buttons) == (rule, agent, size) and r.structure]
                ends = [np.mean([r.structure[-1][measure] for r in own]) for measure in (1, 2)] if own else []
                cells.append(" / ".join(f"{end:.2f}" for end in ends) or "—")
            lines.append(f"| {rule} | {agent} | " + " | ".join(cells) + " |")
    return [*lines, "", "Each cell: mean precision / mean recall at the end of the trials."]


def _make_counts(results: Sequence[ScalingRun]) -> list[str]:
    """Number of runs of each agent; the tables count only those."""
    counts = [f"`{agent}` {sum(r.agent == agent for r in results)}" for agent in AGENTS]
    return [f"Trials: {', '.join(counts)}."]
