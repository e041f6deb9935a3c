"""Sentences on how far the agents of the scaling study come, chosen and filled by rule from its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import ALPHA, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.names import count_nouns, join_words
from studies.scaling.followed_runs import count_spared
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import (
    AGENTS,
    BAR,
    BAR_AGENT,
    NEAR_BEST,
    RULES,
    SIZES,
)

__all__ = ["advise_sizes", "tell_certainty", "tell_replication", "tell_sizes"]


def tell_sizes(results: Sequence[ScalingRun]) -> list[str]:
    """For each rule the most buttons with which all planned runs of an agent escape, agents of one size together."""
    sentences = []
    for rule in RULES:
        reach: dict[int, list[str]] = {}
        for agent in AGENTS:
            own = [run for run in results if (run.agent, run.rule) == (agent, rule)]
            if own:
                size, is_tried = _find_reach(own)
                name = f"`{agent.removeprefix('smdp-')}`"
                reach.setdefault(size, []).append(name if is_tried else f"{name} (not tried with more)")
        parts = [f"{f'up to {size}' if size else 'with no number of'} buttons for {join_words(names)}"
                 for size, names in sorted(reach.items(), reverse=True)]
        if parts:
            sentences.append(f"With the {rule} rule all planned runs escape {'; '.join(parts)}.")
    return sentences


def advise_sizes(results: Sequence[ScalingRun]) -> str:
    """Advice to a user: the agents that come furthest whatever the rule, how far, and whether others are told apart."""
    reach = {agent: min(_find_reach([run for run in results if (run.agent, run.rule) == (agent, rule)])[0]
                        for rule in RULES if any((run.agent, run.rule) == (agent, rule) for run in results))
             for agent in AGENTS if any(run.agent == agent for run in results)}
    most = max(reach.values())
    if not most:
        return "Begin with fewer buttons: no agent escapes in all runs of any size."
    names = [f"`{agent.removeprefix('smdp-')}`" for agent, size in reach.items() if size == most]
    return (f"For many buttons take {join_words(names, 'or')}, which {'comes' if len(names) == 1 else 'come'} furthest "
            f"whatever the rule, up to {most} buttons{_tell_lead(results, reach)}.")


def _tell_lead(results: Sequence[ScalingRun], reach: Mapping[str, int]) -> str:
    """A clause: next best agents that Fisher's test does not tell from the first, where they fall behind; else empty.

    Args:
        results: all runs.
        reach: agent -> most buttons with which all its runs escape, whatever the rule.
    """
    most = max(reach.values())
    second = max((size for size in reach.values() if size < most), default=0)
    first = next(agent for agent, size in reach.items() if size == most)
    parts = []
    for rule in RULES:
        own, count = _count_escapes(results, rule, first, most)
        near = []
        for agent in (agent for agent, size in reach.items() if size == second):
            hits, runs = _count_escapes(results, rule, agent, most)
            p = float(np.asarray(stats.fisher_exact([(own, count - own), (hits, runs - hits)]))[1])
            if hits < runs and p >= ALPHA:
                near.append(f"{hits} of {runs} of `{agent.removeprefix('smdp-')}`")
        if near:
            parts.append(f"with {most} buttons under `{rule}` {own} of {count} runs of `{first.removeprefix('smdp-')}` "
                         f"escape, {join_words(near)}")
    return f"; the lead is not told apart: {', and '.join(parts)}" if parts else ""


def _count_escapes(results: Sequence[ScalingRun], rule: str, agent: str, size: int) -> tuple[int, int]:
    """Runs of an agent that escape with some number of buttons, and all that were planned."""
    own = [run for run in results if (run.rule, run.agent, run.buttons) == (rule, agent, size)]
    return (sum(run.first_escape is not None for run in own),
            len(own) + count_spared(results, rule, agent, size))


def _find_reach(own: Sequence[ScalingRun]) -> tuple[int, bool]:
    """The most buttons with which all runs escape, and whether it was tried with more, where there are more."""
    most, is_tried = 0, True
    for size in SIZES:
        here = [run for run in own if run.buttons == size]
        is_spared = count_spared(own, own[0].rule, own[0].agent, size) > 0
        is_tried = bool(here) or is_spared
        if not here or is_spared or any(run.first_escape is None for run in here):
            break
        most = size
    return most, is_tried


def tell_certainty(results: Sequence[ScalingRun]) -> str:
    """A sentence: lower 95 % end of the share that escape, where all runs of a cell do, by their number."""
    cells: dict[tuple[str, str, int], list[bool]] = {}
    for run in results:
        cells.setdefault((run.agent, run.rule, run.buttons), []).append(run.first_escape is not None)
    counts = sorted({len(escaped) for (agent, rule, size), escaped in cells.items()
                     if all(escaped) and not count_spared(results, rule, agent, size)})
    parts = [f"{0.025 ** (1 / count):.2f} or more with {count_nouns(count, 'run')}" for count in
             dict.fromkeys(counts[:1] + counts[-1:])]
    return (f"Where all runs of a cell escape, the share that would is {join_words(parts)} (Clopper and Pearson)."
            if parts else "")


def tell_replication(fresh: Sequence[ScalingRun], published: Sequence[ScalingRun]) -> list[str]:
    """A sentence for each room of the bar: fresh seeds and rooms beside the published runs.

    Shares of runs near the best are compared by Fisher's exact test, the rooms of the bar as one family (Holm).
    """
    both = {task: [[run for run in runs if (run.task, run.agent) == (task, BAR_AGENT)] for runs in (fresh, published)]
            for task in BAR}
    both = {task: pair for task, pair in both.items() if all(pair)}
    counts = {task: [_count_near(runs) for runs in pair] for task, pair in both.items()}
    tests = [stats.fisher_exact([(hits, count - hits) for hits, count in rows]) for rows in counts.values()]
    p = correct_by_holm([float(np.asarray(test)[1]) for test in tests])
    sentences = []
    for (task, (own, known)), (now, before), corrected in zip(both.items(), counts.values(), p, strict=True):
        seeds = sorted(run.run for run in own)
        exact = sum(bool(run.structure) and run.structure[-1][1:] == (1.0, 1.0) for run in own)
        sentences.append(
            f"{task.buttons} buttons, {task.graph}, {task.rule}: {now[0]} of {now[1]} reach {NEAR_BEST:.0%} of the "
            f"best return (seeds {seeds[0]} to {seeds[-1]}), {_compare(now, before, corrected)}, and {exact} have the "
            f"whole graph without an edge too many; first escape after {_tell_median(own)} primitives, "
            f"where the published runs take {_tell_median(known)} (medians).")
    return sentences


def _count_near(runs: Sequence[ScalingRun]) -> tuple[int, int]:
    """Runs near the best, and all."""
    return sum(run.near_best is not None for run in runs), len(runs)


def _compare(now: tuple[int, int], before: tuple[int, int], p: float) -> str:
    published = f"the published {before[0]} of {before[1]}"
    if min(now[1], before[1]) < LEAST_RUNS:
        return f"too few runs to compare with {published}"
    if p >= ALPHA:
        return f"which does not differ significantly from {published}"
    return f"{'more' if now[0] * before[1] > before[0] * now[1] else 'fewer'} than {published}"


def _tell_median(runs: Sequence[ScalingRun]) -> str:
    escapes = [run.first_escape for run in runs if run.first_escape is not None]
    return f"{np.median(escapes):,.0f}" if escapes else "no number of"
