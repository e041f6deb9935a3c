"""The page of the baselines, written from their lines alone."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.registry import SMDP_PREFIX
from hrl_escape.comparison.baselines.calibration import KNOWN, tell_calibration
from hrl_escape.comparison.baselines.lines import LEAST_RUNS, BaselineRun, compute_run_efficiency
from hrl_escape.comparison.baselines.running import GENERALISTS, LEARNERS
from hrl_escape.comparison.baselines.tower import describe_tower
from hrl_escape.comparison.inference import compute_wilson_interval
from hrl_escape.comparison.ladder_score import compute_ladder_score
from hrl_escape.comparison.protocols import PASSED_EFFICIENCY, PASSED_ESCAPES, TOWER, get_budget
from hrl_escape.files import write_text
from hrl_escape.names import join_words

__all__ = ["write_baselines_page"]

_Cells: TypeAlias = Mapping[tuple[str, str], Sequence[BaselineRun]]
"""Runs of one protocol by rung and agent."""

_COMMAND = "hrl-escape experiment ladder"
_WORDS = {
    "per-instance": "Each test room is learned from nothing and tested in itself.",
    "generalise": "Trained in rooms of the training set, tested in others that were never trained in.",
}


def write_baselines_page(lines: Sequence[BaselineRun], rungs: Sequence[str], path: Path,
                         noisy: Collection[str] = ()) -> None:
    """Write the page.

    Args:
        lines: at least one.
        rungs: names of the rungs, in order.
        path: the page's file.
        noisy: rungs in which moves err.

    Raises:
        FileWriteError: the file cannot be written.
    """
    tower = [line for line in lines if line.protocol == TOWER]
    lines = [line for line in lines if line.protocol != TOWER]
    text = ["# Baselines of the ladder", "", *([_summarise(lines, rungs), ""] if lines else []),
            "Efficiency is the interquartile mean over runs (fewer than four: the mean); in brackets the runs, rooms "
            f"times seeds. Bold: {PASSED_ESCAPES:.0%} of the episodes or more escape, with an efficiency of "
            f"{PASSED_EFFICIENCY:g} or more. A dash: not run. Every run is a line of `raw/ladder.jsonl`.", "",
            *_explain_traits(lines)]
    for protocol in [name for name in _WORDS if any(line.protocol == name for line in lines)]:
        own = [line for line in lines if line.protocol == protocol]
        parts = _part(own)
        text += [f"## {protocol}", "", _WORDS[protocol], "", _describe_budgets(own, rungs), ""]
        for title, part in parts.items():
            cells = _group(part)
            text += [*([f"### {title}", ""] if len(parts) > 1 else []), *_make_table(cells, rungs), "",
                     *_name_highest(cells, rungs), "", *_score(cells, rungs)]
        if protocol == "per-instance":
            told = tell_calibration(_group(next(iter(parts.values()))), rungs, noisy)
            text += ["### Calibration", "", f"By cells of {LEAST_RUNS} runs or more.", "",
                     *(f"- {sentence}" for sentence in told), ""] if told else []
    text += describe_tower(tower, _COMMAND, max(map(get_budget, rungs)))
    text += ["```console", *_list_commands(lines, rungs), "```", "", "The commands go on with the runs that are "
             "missing, and more `--rooms`, `--runs` or `--minutes` add others. Without options the command is the "
             "whole: 10 rooms, 10 seeds, 20 episodes, and the rungs' own budgets.", ""]
    write_text(path, "\n".join(text))


def _part(lines: Sequence[BaselineRun]) -> dict[str, list[BaselineRun]]:
    """Lines by what their agents choose among: tables are of agents that have the same choices."""
    parts: dict[str, list[BaselineRun]] = {"Over options": [], "Over primitives": []}
    for line in lines:
        has_options = line.agent.startswith(SMDP_PREFIX) or line.agent == KNOWN
        parts["Over options" if has_options else "Over primitives"].append(line)
    return {title: part for title, part in parts.items() if part}


def _explain_traits(lines: Sequence[BaselineRun]) -> list[str]:
    """Meaning of the traits in the agents' names."""
    if not any("+three-parents" in line.agent for line in lines):
        return []
    return ["`+three-parents`: told that up to three buttons may have to be on together for another to come on, where "
            "the same agent otherwise considers up to two.", ""]


def _list_commands(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> list[str]:
    """Command lines that make at least these runs, one for each protocol, kind of choices and budget."""
    commands, parts = [], _part(lines)
    kinds = {(line.protocol, title, line.primitives) for title, part in parts.items() for line in part}
    for protocol, title, budget in sorted(kinds):
        own = [line for line in parts[title] if (line.protocol, line.primitives) == (protocol, budget)]
        there = [rung for rung in rungs if any(line.rung == rung for line in own)]
        rooms = max(len({line.rooms for line in own if line.rung == rung}) for rung in there)
        episodes = max(line.episodes for line in own)
        words = [_COMMAND, "--protocol", protocol, "--rung", *there, "--agents",
                 *_sort_agents(line.agent for line in own), "--runs", str(1 + max(line.seed for line in own))]
        words += ["--rooms", str(rooms), "--eval-episodes", str(episodes)] if protocol == "per-instance" else [
            "--rooms", str(episodes)]
        commands.append(" ".join([*words, *(["--primitives", str(budget)] if budget else [])]))
    return commands


def _summarise(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> str:
    cells = _group([line for line in lines if line.protocol == "per-instance"] or lines)
    learners = {agent: _find_highest(cells, agent, rungs)
                for agent in _sort_agents(agent for (_, agent), runs in cells.items() if runs[0].primitives)}
    words = f"{len(lines)} runs on {len({line.rung for line in lines})} rungs."
    reached = [rung for rung in learners.values() if rung is not None]
    if not reached:
        enough = any(len(cells.get((rung, agent), ())) >= LEAST_RUNS for agent in learners for rung in rungs)
        why = "" if enough else f": none has {LEAST_RUNS} runs on one, and fewer say nothing of the next room"
        return f"**No learner is shown to master a rung{why}.** {words}"
    top = max(reached, key=list(rungs).index)
    best = [f"`{agent}`" for agent, rung in learners.items() if rung == top]
    return f"**The highest rung that a learner masters is `{top}`, by {', '.join(best)}.** {words}"


def _sort_agents(agents: Iterable[str]) -> list[str]:
    """Each agent once, in the order of the baselines, others after them."""
    known = list(dict.fromkeys((*LEARNERS, *GENERALISTS)))
    return sorted(set(agents), key=lambda agent: (known.index(agent) if agent in known else len(known), agent))


def _group(lines: Sequence[BaselineRun]) -> _Cells:
    """Runs by rung and agent, of several budgets those of the largest; agents in the order of the baselines."""
    cells: dict[tuple[str, str], list[BaselineRun]] = {}
    agents = _sort_agents(line.agent for line in lines)
    for line in sorted(lines, key=lambda line: agents.index(line.agent)):
        cells.setdefault((line.rung, line.agent), []).append(line)
    most = {place: max(run.primitives for run in runs) for place, runs in cells.items()}
    return {place: [run for run in runs if run.primitives == most[place]] for place, runs in cells.items()}


def _describe_budgets(lines: Sequence[BaselineRun], rungs: Sequence[str]) -> str:
    budgets = sorted({line.primitives for line in lines if line.primitives})
    episodes = join_words([str(number) for number in sorted({line.episodes for line in lines})])
    short = [f"`{rung}` ({get_budget(rung):,})" for rung in rungs
             if 0 < max((line.primitives for line in lines if line.rung == rung), default=0) < get_budget(rung)]
    less = f" That is less than the rung's own budget on {join_words(short)}." if short else ""
    return (f"Learners train for {join_words([f'{budget:,}' for budget in budgets]) or 'no'} primitives, "
            f"the largest budget of a cell counting; {episodes} episodes an evaluation.{less}")


def _make_table(cells: _Cells, rungs: Sequence[str]) -> list[str]:
    agents = _sort_agents(agent for _, agent in cells)
    rows = ["| rung | " + " | ".join(f"`{agent}`" for agent in agents) + " |", "|---" * (len(agents) + 1) + "|"]
    for rung in rungs:
        row = [cells.get((rung, agent), ()) for agent in agents]
        if any(row):
            rows.append(f"| `{rung}` | " + " | ".join(map(_format_cell, row)) + " |")
    return rows


def _is_shown(runs: Sequence[BaselineRun]) -> bool:
    """Return whether so many runs pass that it is said."""
    return len(runs) >= LEAST_RUNS and _is_mastered(runs)


def _format_cell(runs: Sequence[BaselineRun]) -> str:
    if not runs:
        return "-"
    text = f"{compute_run_efficiency(runs):.2f}"
    return f"{f'**{text}**' if _is_mastered(runs) else text} ({len(runs)})"


def _is_mastered(runs: Sequence[BaselineRun]) -> bool:
    """Return whether the numbers themselves pass, however few they are."""
    return (float(np.mean([run.escapes for run in runs])) >= PASSED_ESCAPES
            and compute_run_efficiency(runs) >= PASSED_EFFICIENCY)


def _is_passed(runs: Sequence[BaselineRun]) -> bool:
    """Return whether so many runs are enough to be sure; episodes in one room are one try."""
    tries = len(runs) if runs[0].protocol == "per-instance" else sum(run.episodes for run in runs)
    low, _ = compute_wilson_interval(float(np.mean([run.escapes for run in runs])), tries)
    return _is_mastered(runs) and float(low) >= PASSED_ESCAPES


def _find_highest(cells: _Cells, agent: str, rungs: Sequence[str]) -> str | None:
    found = [rung for rung in rungs if _is_shown(cells.get((rung, agent), ()))]
    return found[-1] if found else None


def _score(cells: _Cells, rungs: Sequence[str]) -> list[str]:
    """Ladder scores over the rungs and agents that fill the largest table without gaps."""
    enough = {rung: {agent for (place, agent), runs in cells.items() if place == rung and len(runs) >= LEAST_RUNS}
              for rung in rungs}
    chosen = max(enough.values(), key=lambda chosen: len(chosen) * sum(chosen <= there for there in enough.values()))
    common = [rung for rung, there in enough.items() if chosen <= there]
    if not chosen:
        return []
    rows = []
    for agent in _sort_agents(chosen):
        score = compute_ladder_score([_split(cells[rung, agent]) for rung in common], np.random.default_rng(0))
        rows.append(f"| `{agent}` | {score.value:.2f} | {score.low:.2f} to {score.high:.2f} |")
    names = join_words(f"`{rung}`" for rung in common)
    return [f"Ladder score: the mean of the efficiency over {names}, where all of these agents have {LEAST_RUNS} runs "
            "or more, with an interval that draws rooms as a whole.", "",
            "| agent | score | 95 % |", "|---|---|---|", *rows, ""]


def _split(runs: Sequence[BaselineRun]) -> list[NDArray[np.float64]]:
    """Efficiencies (runs,) of each room that was learned in, or of each run alone that was tested in others."""
    units: dict[object, list[float]] = {}
    for run in runs:
        units.setdefault(run.rooms if run.protocol == "per-instance" else run.seed, []).append(run.efficiency)
    return [np.array(unit) for unit in units.values()]


def _name_highest(cells: _Cells, rungs: Sequence[str]) -> list[str]:
    text = [f"| agent | highest rung mastered, with {LEAST_RUNS} runs or more | passed, by Wilson's interval |",
            "|---|---|---|"]
    for agent in _sort_agents(agent for _, agent in cells):
        sure = [rung for rung in rungs if (runs := cells.get((rung, agent))) and _is_passed(runs)]
        text.append(f"| `{agent}` | {_find_highest(cells, agent, rungs) or 'none'} | {sure[-1] if sure else 'none'} |")
    fewest = min(cells.values(), key=len)
    few = len(fewest)
    if few < 35 and fewest[0].protocol == "per-instance":
        text += ["", f"To pass takes 35 runs without a failure at least: the lower end of Wilson's interval reaches "
                 f"{PASSED_ESCAPES:g} with no fewer. Some cells have {few}."]
    return text
