"""The ladder's baselines: tables by protocol, what is mastered and passed, scores, calibration, and the tower."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from hrl_escape.agents.registry import RANDOM_OPTIONS
from hrl_escape.agents.spec import BAYES, AgentSpec
from hrl_escape.benchmark.inference import (
    ALPHA,
    compare_pairs,
    compute_wilson_interval,
    correct_by_holm,
)
from hrl_escape.benchmark.protocols import PASSED_EFFICIENCY, PASSED_RATE, TOWER, compute_ladder_score, get_budget
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.benchmark.reporting.figures import SPARE
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.names import count_nouns, join_words
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON
from studies.baseline import BaselineRun, compute_run_efficiency
from studies.figures import FIGURE_STYLE
from studies.ladder.baselines import (
    GENERALISTS,
    LEARNERS,
    BaselineArgs,
    collect_lines,
    list_missing,
    run_baselines,
)
from studies.ladder.calibration import KNOWN, average_rooms, tell_calibration
from studies.page import make_table
from studies.statistics import choose_holm_levels, find_visible_difference, tell_power
from studies.store import Store
from studies.study import Page, Study

__all__ = ["Args", "analyse", "describe", "draw", "group_runs", "measure", "subtract", "tabulate", "tell_bar",
           "tell_beyond_searching", "tell_blank", "tell_visible"]

Args = BaselineArgs
_Cells: TypeAlias = Mapping[tuple[str, str], Sequence[BaselineRun]]
"""Runs of one protocol by rung and agent."""
NOTHING_BEYOND = (f"Nothing is concluded, as no learner has {LEAST_RUNS} rooms on a rung beside a searcher that learns "
                  "nothing.")
MOST_TO_PASS = 35
"""Runs without a failure that passing takes at least."""


def measure(study: Study, args: BaselineArgs, store: Store) -> None:
    """Run what is missing, keep the lines, and say what failed and what is left."""
    found = run_baselines(load_benchmark(study.data["benchmark"]), args)
    store.add(collect_lines(found))
    console = Console(highlight=False, soft_wrap=True)
    failures = [failure for comparison in found.values() for failure in comparison.failures]
    for message, count in Counter(failure.message for failure in failures).items():
        console.print(f"{count} runs failed: {message}", markup=False)
    console.print(f"{list_missing(found) - len(failures)} runs are left for another time")


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Page:
    """Values of the page on the benchmark's rungs."""
    bench = load_benchmark(study.data["benchmark"])
    return describe(lines, [rung.name for rung in bench],
                    [rung.name for rung in bench if rung.config.dynamics.is_random])


def describe(lines: Sequence[BaselineRun], rungs: Sequence[str], noisy: Collection[str] = ()) -> Page:
    """Values of the page.

    Args:
        lines: at least one.
        rungs: names of the rungs, in order.
        noisy: rungs in which moves err.
    """
    lines = sorted(lines, key=lambda line: line.place)
    tower = [line for line in lines if line.protocol == TOWER]
    lines = [line for line in lines if line.protocol != TOWER]
    alone = _part([line for line in lines if line.protocol == "per-instance"])
    over = group_runs(alone.get("Over options", ()))
    return Page({
        "PASSED_RATE": PASSED_RATE, "PASSED_EFFICIENCY": PASSED_EFFICIENCY, "MOST_TO_PASS": MOST_TO_PASS,
        "SEQUENCE_HORIZON": SEQUENCE_HORIZON,
        "beyond": tell_beyond_searching(over, rungs), "visible": tell_visible(over, rungs),
        "advice": tell_bar(over, rungs), "blank": tell_blank(over, rungs),
        "lines": lines, "rungs": {line.rung for line in lines}, "mastery": _find_mastery(lines, rungs),
        "has_three_parents": any("@three-parents" in line.agent for line in lines),
        "protocols": {name: _describe_protocol(own, rungs) for name in ("per-instance", "generalise")
                      if (own := [line for line in lines if line.protocol == name])},
        "calibration": tell_calibration(group_runs(next(iter(alone.values()))), rungs, noisy) if alone else [],
        "tower": _describe_tower(tower, max(map(get_budget, rungs))), "commands": _list_options(lines, rungs),
    }, {"ladder": draw(over, rungs)} if over else {})


def tell_beyond_searching(cells: _Cells, rungs: Sequence[str]) -> str:
    """The finding: which learners are more efficient than the best searcher that learns nothing, over their rungs.

    On each rung the searcher that does best there counts; a learner is one test, with rungs as strata and rooms as
    pairs, and all learners are one family (Holm).
    """
    tests = {agent: (compare_pairs(gains), gains) for agent, gains in _list_gains(cells, rungs).items()}
    if not tests:
        return NOTHING_BEYOND
    raw = [test.p for test, _ in tests.values()]
    better = [f"`{agent}` ({test.difference:+.2f}, {test.low:+.2f} to {test.high:+.2f}, over "
              f"{count_nouns(len(gains), 'rung')})" for (agent, (_, gains)), p, level in
              zip(tests.items(), correct_by_holm(raw), choose_holm_levels(raw), strict=True)
              if (test := compare_pairs(gains, level)).difference > 0 and p < ALPHA]
    if not better:
        return "No learner is shown to beat the best searcher that learns nothing over the rungs that it was run on."
    return (f"{len(better)} of {len(tests)} learners beat the best searcher that learns nothing: {join_words(better)}.")


def tell_visible(cells: _Cells, rungs: Sequence[str]) -> str:
    """A sentence: the gains that these tests would have seen."""
    every = list(_list_gains(cells, rungs).values())
    return tell_power([find_visible_difference(gains, ALPHA / len(every)) for gains in every], "a gain of",
                      "{:.2f}".format)


def tell_bar(cells: _Cells, rungs: Sequence[str]) -> str:
    """Bar for an agent: the best searcher, or where that does worse, whatever else learns nothing."""
    agents = _sort_agents(agent for _, agent in cells)
    blind = [agent for agent in agents if not (spec := AgentSpec.parse(agent)).learns and spec.name not in
             ("oracle", "bayes")]
    above: dict[str, list[str]] = {}
    for rung, best in find_best_searchers(cells, rungs).items():
        known = [agent for agent in blind if (rung, agent) in cells]
        first = max(known, key=lambda agent, rung=rung: compute_run_efficiency(cells[rung, agent]), default="")
        if best and compute_run_efficiency(cells[rung, first]) > compute_run_efficiency(cells[rung, best]):
            above.setdefault(first, []).append(f"`{rung}`")
    said = "What your agent has to beat on a rung is the best searcher that learns nothing"
    if not above:
        return f"{said}, and not chance or a round in the order of the numbers; its column stands in the table below."
    others = join_words(f"`{agent}`, which does better there, on {join_words(own)}" for agent, own in above.items())
    return f"{said}, and {others}; the columns stand in the table below."


def tell_blank(cells: _Cells, rungs: Sequence[str]) -> list[str]:
    """A sentence a learner whose episodes after training are those of random options, room by room and one by one."""
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
                found.setdefault(agent, []).append(f"`{rung}`")
    return [f"`{agent}` has no model on {join_words(own)}: after training it plays every episode as `{chance}` does."
            for agent, own in found.items()]


def find_best_searchers(cells: _Cells, rungs: Sequence[str]) -> dict[str, str | None]:
    """The searcher that does best on each rung, of equal ones the first whatever the order of a set; None without."""
    agents = _sort_agents(agent for _, agent in cells)
    searchers = [agent for agent in agents if AgentSpec.parse(agent).name in SEARCH_BASELINES]
    return {rung: max((agent for agent in searchers if len(cells.get((rung, agent), ())) >= LEAST_RUNS),
                      key=lambda agent, rung=rung: compute_run_efficiency(cells[rung, agent]), default=None)
            for rung in rungs}


def _list_gains(cells: _Cells, rungs: Sequence[str]) -> dict[str, list[NDArray[np.float64]]]:
    """Differences of each learner from the best searcher, room by room on each rung where both have enough."""
    best, found = find_best_searchers(cells, rungs), {}
    for agent in _sort_agents(agent for (_, agent), runs in cells.items() if runs[0].primitives):
        if gains := [gain for rung in rungs if (other := best[rung]) is not None
                     and len(gain := subtract(cells.get((rung, agent), ()), cells[rung, other])) >= LEAST_RUNS]:
            found[agent] = gains
    return found


def subtract(runs: Sequence[BaselineRun], others: Sequence[BaselineRun]) -> NDArray[np.float64]:
    """Differences of mean efficiency in the rooms that both have, (rooms,)."""
    ours, theirs = map(average_rooms, (runs, others))
    return np.array([ours[room] - theirs[room] for room in sorted(ours.keys() & theirs.keys())])


def draw(cells: _Cells, rungs: Sequence[str]) -> Figure:
    """Efficiency of agents over options rung by rung; the best searcher black, chance and rounds grey."""
    agents = _sort_agents(agent for _, agent in cells)
    shown = [rung for rung in rungs if any(place == rung for place, _ in cells)]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 4.0), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        colours = iter((*palette.LINES, *SPARE))
        searched = np.full(len(shown), np.nan)
        for agent in agents:
            spec = AgentSpec.parse(agent)
            values = np.array([compute_run_efficiency(cells[rung, agent]) if (rung, agent) in cells else np.nan
                               for rung in shown])
            if spec.name in SEARCH_BASELINES:
                searched = np.fmax(searched, values)
            elif spec.name == BAYES:
                axes.plot(shown, values, ":", color=palette.INK, linewidth=1.3, label="told how rooms are drawn")
            elif spec.learns:
                axes.plot(shown, values, "o-", markersize=4, linewidth=1.3, color=next(colours),
                          label=agent)
            elif spec.algorithm == "random":
                axes.plot(shown, values, "--", color=palette.MUTED, linewidth=1.3, label="random options")
        axes.plot(shown, searched, color=palette.INK, linewidth=2.2, label="best searcher without learning")
        axes.set_ylim(-0.03, 1.03)
        axes.set_ylabel("efficiency", color=palette.INK)
        axes.grid(axis="y", color="#e5dfd2", linewidth=0.8)
        axes.tick_params(axis="x", rotation=60)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _describe_protocol(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> dict[str, Any]:
    """Budgets of one protocol, and a part for each kind of choices."""
    short = [f"`{rung}` ({get_budget(rung):,})" for rung in rungs
             if 0 < max((line.primitives for line in lines if line.rung == rung), default=0) < get_budget(rung)]
    parts = {}
    for title, part in _part(lines).items():
        cells = group_runs(part)
        fewest = min(cells.values(), key=len)
        parts[title] = {
            "table": tabulate(cells, rungs), "highest": _tabulate_highest(cells, rungs),
            "few": len(fewest) if len(fewest) < MOST_TO_PASS and fewest[0].protocol == "per-instance" else None,
            "scores": _score(cells, rungs),
        }
    return {"budgets": sorted({line.primitives for line in lines if line.primitives}),
            "episodes": sorted({line.episodes for line in lines}), "short": short, "parts": parts}


def _find_mastery(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> dict[str, Any]:
    """The highest rung that a learner masters, and who does; else whether any learner has runs enough on one."""
    cells = group_runs([line for line in lines if line.protocol == "per-instance"] or lines)
    learners = {agent: _find_highest(cells, agent, rungs)
                for agent in _sort_agents(agent for (_, agent), runs in cells.items() if runs[0].primitives)}
    top = max((rung for rung in learners.values() if rung is not None), key=list(rungs).index, default=None)
    return {"rung": top, "agents": [agent for agent, rung in learners.items() if rung == top],
            "has_runs": any(len(cells.get((rung, agent), ())) >= LEAST_RUNS for agent in learners for rung in rungs)}


def _part(lines: Sequence[BaselineRun]) -> dict[str, list[BaselineRun]]:
    """Lines by what their agents choose among: tables are of agents that have the same choices."""
    parts: dict[str, list[BaselineRun]] = {"Over options": [], "Over primitives": []}
    for line in lines:
        has_options = line.agent == KNOWN or AgentSpec.parse(line.agent).chooses_options
        parts["Over options" if has_options else "Over primitives"].append(line)
    return {title: part for title, part in parts.items() if part}


def group_runs(lines: Sequence[BaselineRun]) -> _Cells:
    """Runs by rung and agent, of several budgets those of the largest; agents in the order of the baselines."""
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


def _list_options(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> list[str]:
    """Options of commands that make at least these runs, for each protocol, kind of choices and budget."""
    commands, parts = [], _part(lines)
    kinds = {(line.protocol, title, line.primitives) for title, part in parts.items() for line in part}
    for protocol, title, budget in sorted(kinds):
        own = [line for line in parts[title] if (line.protocol, line.primitives) == (protocol, budget)]
        there = [rung for rung in rungs if any(line.rung == rung for line in own)]
        rooms = max(len({line.rooms for line in own if line.rung == rung}) for rung in there)
        episodes = max(line.episodes for line in own)
        words = ["--protocol", protocol, "--rung", *there, "--agents",
                 *_sort_agents(line.agent for line in own), "--runs", str(1 + max(line.seed for line in own))]
        words += ["--rooms", str(rooms), "--eval-episodes", str(episodes)] if protocol == "per-instance" else [
            "--rooms", str(episodes)]
        commands.append(" ".join([*words, *(["--primitives", str(budget)] if budget else [])]))
    return commands


def tabulate(cells: _Cells, rungs: Sequence[str]) -> str:
    """Efficiency, a row a rung and a column an agent; bold where it is mastered."""
    agents = _sort_agents(agent for _, agent in cells)
    rows = [(rung, [cells.get((rung, agent), ()) for agent in agents]) for rung in rungs]
    return make_table(["rung", *(f"`{agent}`" for agent in agents)],
                      [[f"`{rung}`", *map(_format_cell, row)] for rung, row in rows if any(row)])


def _format_cell(runs: Sequence[BaselineRun]) -> str:
    if not runs:
        return "-"
    text = f"{compute_run_efficiency(runs):.2f}"
    return f"{f'**{text}**' if _is_mastered(runs) else text} ({len(runs)})"


def _is_shown(runs: Sequence[BaselineRun]) -> bool:
    """Return whether so many runs pass that it is said."""
    return len(runs) >= LEAST_RUNS and _is_mastered(runs)


def _is_mastered(runs: Sequence[BaselineRun]) -> bool:
    """Return whether the numbers themselves pass, however few they are."""
    return (float(np.mean([run.escapes for run in runs])) >= PASSED_RATE
            and compute_run_efficiency(runs) >= PASSED_EFFICIENCY)


def _is_passed(runs: Sequence[BaselineRun]) -> bool:
    """Return whether so many runs are enough to be sure; episodes in one room are one try."""
    tries = len(runs) if runs[0].protocol == "per-instance" else sum(run.episodes for run in runs)
    low, _ = compute_wilson_interval(float(np.mean([run.escapes for run in runs])), tries)
    return _is_mastered(runs) and float(low) >= PASSED_RATE


def _find_highest(cells: _Cells, agent: str, rungs: Sequence[str]) -> str | None:
    found = [rung for rung in rungs if _is_shown(cells.get((rung, agent), ()))]
    return found[-1] if found else None


def _tabulate_highest(cells: _Cells, rungs: Sequence[str]) -> str:
    rows = []
    for agent in _sort_agents(agent for _, agent in cells):
        sure = [rung for rung in rungs if (runs := cells.get((rung, agent))) and _is_passed(runs)]
        rows.append([f"`{agent}`", _find_highest(cells, agent, rungs) or "none", sure[-1] if sure else "none"])
    return make_table(["agent", f"highest rung mastered, with {LEAST_RUNS} runs or more",
                       "passed, by Wilson's interval"], rows)


def _score(cells: _Cells, rungs: Sequence[str]) -> dict[str, Any] | None:
    """Ladder scores over the rungs and agents that fill the largest table without gaps; None where there is none."""
    enough = {rung: {agent for (place, agent), runs in cells.items() if place == rung and len(runs) >= LEAST_RUNS}
              for rung in rungs}
    chosen = max(enough.values(), key=lambda chosen: len(chosen) * sum(chosen <= there for there in enough.values()))
    common = [rung for rung, there in enough.items() if chosen <= there]
    if not chosen:
        return None
    scores = {agent: compute_ladder_score([_split(cells[rung, agent]) for rung in common], np.random.default_rng(0))
              for agent in _sort_agents(chosen)}
    return {"rungs": common, "table": make_table(["agent", "score", "95 %"], [
        [f"`{agent}`", f"{score.value:.2f}", f"{score.low:.2f} to {score.high:.2f}"]
        for agent, score in scores.items()])}


def _split(runs: Sequence[BaselineRun]) -> list[NDArray[np.float64]]:
    """Efficiencies (runs,) of each room that was learned in, or of each run alone that was tested in others."""
    units: dict[object, list[float]] = {}
    for run in runs:
        units.setdefault(run.rooms if run.protocol == "per-instance" else run.seed, []).append(run.efficiency)
    return [np.array(unit) for unit in units.values()]


def _describe_tower(lines: Sequence[BaselineRun], budget: int) -> dict[str, Any] | None:
    """Values of the section on the tower; None without a run.

    Args:
        lines: runs in the tower.
        budget: primitives that the protocol itself trains for.
    """
    if not lines:
        return None
    rows, agents = [], list(dict.fromkeys(line.agent for line in sorted(lines, key=lambda line: -line.efficiency)))
    for agent in agents:
        most = max(line.primitives for line in lines if line.agent == agent)
        runs = [line for line in lines if (line.agent, line.primitives) == (agent, most)]
        rows.append([f"`{agent}`", len(runs), f"{most:,}", f"{compute_run_efficiency(runs):.2f}",
                     f"{float(np.mean([run.escapes for run in runs])):.0%}"])
    return {
        "floors": max(line.rooms.partition(" > ")[2] for line in lines), "agents": agents, "budget": budget,
        "episodes": max(line.episodes for line in lines), "trained": max(line.primitives for line in lines),
        "fewest": min(Counter((line.agent, line.primitives) for line in lines).values()),
        "runs": 1 + max(line.seed for line in lines),
        "table": make_table(["agent", "runs", "trained for", "efficiency", "floors climbed"], rows),
    }
