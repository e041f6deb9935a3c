"""Baselines of the ladder: efficiency by rung, comparisons with the best search baseline, calibration and scores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from hrl_escape.agents.registry import RANDOM_OPTIONS
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.protocols import SEQUENCE, get_budget
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.benchmark.standings import PASSED_EFFICIENCY, PASSED_RATE, compute_ladder_score
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.sets.benchmark import load_benchmark
from studies.baseline import BaselineRun, compute_run_efficiency
from studies.figures import Theme, draw_rows
from studies.ladder.baselines import (
    GENERALISTS,
    LEARNERS,
    BaselineArgs,
    collect_lines,
    list_missing,
    run_baselines,
)
from studies.ladder.calibration import KNOWN, Cells, average_rooms, compare_orders, compare_steps
from studies.statistics import Difference, compare_strata
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import format_gain, make_table

__all__ = ["Args", "Beyond", "analyse", "compare_with_search", "describe", "draw_rungs", "find_blank", "group_runs",
           "measure", "subtract", "tabulate"]

Args = BaselineArgs


class Beyond(NamedTuple):
    """Difference of a learner from the best search baseline of each rung, over its rungs."""

    found: Difference
    rungs: int


def measure(study: Study, args: BaselineArgs, store: Store) -> None:
    """Run what is missing, keep the lines, and print what failed and what is left."""
    found = run_baselines(load_benchmark(study.data["benchmark"]), args)
    store.add(collect_lines(found))
    console = Console(highlight=False, soft_wrap=True)
    failures = [failure for comparison in found.values() for failure in comparison.failures]
    for message, count in Counter(failure.message for failure in failures).items():
        console.print(f"{count} runs failed: {message}", markup=False)
    console.print(f"{list_missing(found) - len(failures)} runs are left for another time")


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Numbers, tables and the figure of the benchmark's rungs."""
    return describe(lines, [rung.name for rung in load_benchmark(study.data["benchmark"])])


def describe(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> Findings:
    """Numbers, tables and the figure.

    Args:
        lines: at least one.
        rungs: names of the rungs, in order.
    """
    lines = sorted(lines, key=lambda line: line.place)
    alone = _part([line for line in lines if line.protocol == "per-instance"])
    over = group_runs(alone.get("options", ()))
    unseen, sequence = (group_runs([line for line in lines if line.protocol == name])
                        for name in ("generalise", SEQUENCE))
    learners = _sort_agents(agent for (_, agent), runs in over.items() if runs[0].primitives)
    score_rungs, scores = _score(over, rungs)
    numbers = SimpleNamespace(
        runs=len(lines), rungs=[rung for rung in rungs if any(place == rung for place, _ in over)],
        budgets=sorted({line.primitives for line in lines if line.primitives and line.protocol == "per-instance"}),
        short=[rung for rung in rungs if 0 < max(
            (line.primitives for line in lines if line.rung == rung), default=0) < get_budget(rung)],
        means={agent: {rung: compute_run_efficiency(over[rung, agent]) for rung in rungs if (rung, agent) in over}
               for agent in _sort_agents(agent for _, agent in over)},
        mastered={agent: [rung for rung in rungs if is_mastered(over.get((rung, agent), ()))] for agent in learners},
        beyond=compare_with_search(over, rungs), blank=find_blank(over, rungs), steps=compare_steps(over, rungs),
        orders=compare_orders(over, rungs), score_rungs=score_rungs,
        unseen=max(map(len, unseen.values()), default=0), sequence=max(map(len, sequence.values()), default=0))
    tables = {"ladder": tabulate(over, rungs), "ladder_labels": tabulate_labels(over),
              "ladder_beyond": tabulate_beyond(numbers.beyond), "ladder_scores": scores}
    for name, cells in (("ladder_moves", group_runs(alone.get("primitives", ()))), ("ladder_unseen", unseen),
                        ("ladder_sequences", sequence)):
        tables[name] = tabulate(cells, [*rungs, SEQUENCE]) if cells else ""
    return Findings(numbers, tables, {"ladder": partial(
        draw_rungs, over, rungs, ["smdp-factored-r-max", "smdp-ppo", "smdp-q-learning"])})


def compare_with_search(cells: Cells, rungs: Sequence[str]) -> dict[str, Beyond]:
    """Compare each learner with the best search baseline of each rung.

    A learner is one test, with rungs as strata and rooms as pairs, and all learners are one family (Holm).
    """
    best, gains = find_best_baselines(cells, rungs), {}
    for agent in _sort_agents(agent for (_, agent), runs in cells.items() if runs[0].primitives):
        if own := [gain for rung in rungs if (other := best[rung]) is not None
                   and len(gain := subtract(cells.get((rung, agent), ()), cells[rung, other])) >= LEAST_RUNS]:
            gains[agent] = own
    return {agent: Beyond(found, len(gains[agent]))
            for agent, found in zip(gains, compare_strata(list(gains.values())), strict=True)}


def find_blank(cells: Cells, rungs: Sequence[str]) -> dict[str, list[str]]:
    """Learners whose episodes after training equal episodes of random options, room by room, and the rungs."""
    def list_ends(rung: str, agent: str) -> dict[tuple[str, int], tuple[float, float]]:
        return {(run.rooms, run.seed): (run.efficiency, run.escapes) for run in cells.get((rung, agent), ())}

    chance = next((agent for _, agent in cells if AgentSpec.parse(agent).name == RANDOM_OPTIONS), "")
    found: dict[str, list[str]] = {}
    for rung in rungs:
        blind = list_ends(rung, chance)
        for agent in _sort_agents(agent for place, agent in cells if place == rung and AgentSpec.parse(agent).learns):
            own = list_ends(rung, agent)
            if len(own) >= LEAST_RUNS and any(escapes for _, escapes in own.values()) and all(
                    blind.get(place) == end for place, end in own.items()):
                found.setdefault(agent, []).append(rung)
    return found


def find_best_baselines(cells: Cells, rungs: Sequence[str]) -> dict[str, str | None]:
    """The most efficient search baseline of each rung, of equal ones the first by name; None without."""
    agents = _sort_agents(agent for _, agent in cells)
    baselines = [agent for agent in agents if AgentSpec.parse(agent).name in SEARCH_BASELINES]
    return {rung: max((agent for agent in baselines if len(cells.get((rung, agent), ())) >= LEAST_RUNS),
                      key=lambda agent, rung=rung: compute_run_efficiency(cells[rung, agent]), default=None)
            for rung in rungs}


def subtract(runs: Sequence[BaselineRun], others: Sequence[BaselineRun]) -> NDArray[np.float64]:
    """Differences of mean efficiency in the rooms that both have, (rooms,)."""
    ours, theirs = map(average_rooms, (runs, others))
    return np.array([ours[room] - theirs[room] for room in sorted(ours.keys() & theirs.keys())])


def draw_rungs(cells: Cells, rungs: Sequence[str], learners: Sequence[str], theme: Theme) -> Figure:
    """Efficiency of learners and of the best search baseline by rung."""
    shown = [rung for rung in rungs if any(place == rung for place, _ in cells)]
    best = {rung: agent for rung, agent in find_best_baselines(cells, shown).items() if agent}
    return draw_rows(shown, [
        *((AgentSpec.parse(agent).title, {rung: compute_run_efficiency(cells[rung, agent]) for rung in shown
                                          if (rung, agent) in cells}) for agent in learners),
        ("best search baseline", {rung: compute_run_efficiency(cells[rung, agent]) for rung, agent in best.items()}),
    ], "efficiency after training", theme)


def _part(lines: Sequence[BaselineRun]) -> dict[str, list[BaselineRun]]:
    """Lines by what their agents choose among: tables compare agents with the same choices."""
    parts: dict[str, list[BaselineRun]] = {"options": [], "primitives": []}
    for line in lines:
        has_options = line.agent == KNOWN or AgentSpec.parse(line.agent).chooses_options
        parts["options" if has_options else "primitives"].append(line)
    return {title: part for title, part in parts.items() if part}


def group_runs(lines: Sequence[BaselineRun]) -> Cells:
    """Runs with the largest budget by rung and agent, in the order of the baselines."""
    cells: dict[tuple[str, str], list[BaselineRun]] = {}
    agents = _sort_agents(line.agent for line in lines)
    for line in sorted(lines, key=lambda line: agents.index(line.agent)):
        cells.setdefault((line.rung, line.agent), []).append(line)
    most = {place: max(run.primitives for run in runs) for place, runs in cells.items()}
    return {place: [run for run in runs if run.primitives == most[place]] for place, runs in cells.items()}


def _sort_agents(agents: Iterable[str]) -> list[str]:
    """Each agent once, in the order of the baselines, others after them."""
    known = list(dict.fromkeys((*LEARNERS, *GENERALISTS)))
    return sorted(set(agents), key=lambda agent: (known.index(agent) if agent in known else len(known), agent))


def tabulate(cells: Cells, rungs: Sequence[str]) -> str:
    """Efficiency, a row a rung and a column an agent; bold where it is mastered."""
    agents = _sort_agents(agent for _, agent in cells)
    rows = [(rung, [cells.get((rung, agent), ()) for agent in agents]) for rung in rungs]
    return make_table(["rung", *(AgentSpec.parse(agent).title for agent in agents)],
                      [[f"`{rung}`", *map(_format_cell, row)] for rung, row in rows if any(row)])


def _format_cell(runs: Sequence[BaselineRun]) -> str:
    if not runs:
        return "-"
    text = f"{compute_run_efficiency(runs):.2f}"
    return f"{f'**{text}**' if is_mastered(runs) else text} ({len(runs)})"


def is_mastered(runs: Sequence[BaselineRun]) -> bool:
    """Return whether so many episodes escape, and so efficiently, that a rung counts as mastered; no runs do not."""
    return bool(runs) and (float(np.mean([run.escapes for run in runs])) >= PASSED_RATE
            and compute_run_efficiency(runs) >= PASSED_EFFICIENCY)


def tabulate_labels(cells: Cells) -> str:
    """Display name and label of each agent."""
    return make_table(["agent", "label"], [[AgentSpec.parse(agent).title, f"`{agent}`"]
                                           for agent in _sort_agents(agent for _, agent in cells)])


def tabulate_beyond(beyond: Mapping[str, Beyond]) -> str:
    """Differences from the best search baseline; bold where they are significant."""
    return make_table(["learner", "rungs", "difference in efficiency"], [
        [AgentSpec.parse(agent).title, rungs, format_gain(found)] for agent, (found, rungs) in beyond.items()])


def _score(cells: Cells, rungs: Sequence[str]) -> tuple[list[str], str]:
    """Rungs and agents that fill the largest table without gaps, and a table of their ladder scores."""
    enough = {rung: {agent for (place, agent), runs in cells.items() if place == rung and len(runs) >= LEAST_RUNS}
              for rung in rungs}
    chosen = max(enough.values(), key=lambda chosen: len(chosen) * sum(chosen <= there for there in enough.values()))
    common = [rung for rung, there in enough.items() if chosen and chosen <= there]
    scores = {agent: compute_ladder_score([_split(cells[rung, agent]) for rung in common], np.random.default_rng(0))
              for agent in _sort_agents(chosen)}
    return common, make_table(["agent", "score", "95 % interval"], [
        [AgentSpec.parse(agent).title, f"{score.value:.2f}", f"{score.low:.2f} to {score.high:.2f}"]
        for agent, score in scores.items()])


def _split(runs: Sequence[BaselineRun]) -> list[NDArray[np.float64]]:
    """Efficiencies (runs,) of each room that was learned in, or of each run alone that was tested in others."""
    units: dict[object, list[float]] = {}
    for run in runs:
        units.setdefault(run.rooms if run.protocol == "per-instance" else run.seed, []).append(run.efficiency)
    return [np.array(unit) for unit in units.values()]
