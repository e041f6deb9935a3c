"""The verdict of a comparison in plain words, as far as its runs carry it.

Pure functions from a `Summary` to sentences. One agent is called better than another only where
the 95 % interval of the probability of improvement lies above one half and there are runs enough for that to mean
something. Labels of agents stand between backticks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hrl_escape.experiments.scale import CEILING, PLANNER
from hrl_escape.experiments.summary import AgentSummary, Summary

__all__ = ["Sentence", "find_first_reach", "is_better", "write_verdict"]

FEWEST_RUNS = 4
"""With fewer runs each, even a clean separation has a chance above 1 in 20 (2 of 20 orders with three, 2 of 70 with
four), so nothing is called better."""
PUBLISHED_RUNS = 10
GOOD_SCORE = 0.95
SETTLED = 0.9
"""From this share of escapes on, it is said how many primitives an escape takes."""


@dataclass(frozen=True)
class Sentence:
    """One thing to say.

    Attributes:
        kind: the headline, a finding that supports it, or a caution.
        text: plain words; labels of agents between backticks.
    """

    kind: Literal["headline", "finding", "caution"]
    text: str


def write_verdict(summary: Summary) -> list[Sentence]:
    """Say what came out: one headline, then findings, then cautions."""
    findings = [*_compare_views(summary), *_compare_with_chance(summary), *_describe_speed(summary),
                *_describe_gap(summary), *_describe_stuck(summary), *_describe_better_ways(summary)]
    return [Sentence("headline", _write_headline(summary)), *(Sentence("finding", text) for text in findings),
            *(Sentence("caution", text) for text in _write_cautions(summary))]


def is_better(summary: Summary, first: AgentSummary, second: AgentSummary) -> bool:
    """Whether the runs show that one agent scores above another."""
    enough = min(first.fewest_runs, second.fewest_runs) >= FEWEST_RUNS
    return enough and summary.get_improvement(first, second).low > 0.5


def find_first_reach(agent: AgentSummary, level: float = GOOD_SCORE) -> float | None:
    """Primitives after which the middle learning curve first reaches a score; None if it never does."""
    reached = np.flatnonzero(agent.curve.metrics["score"][0] >= level)
    return float(agent.curve.primitives[reached[0]]) if len(reached) else None


# --- headline --------------------------------------------------------------------------


def _write_headline(summary: Summary) -> str:
    leader = _find_leader(summary.agents)
    if leader.success.high == 0:
        return f"Nobody escapes within {summary.grid.primitives:,} primitives of training."
    if len(summary.agents) == 1:
        return f"`{leader.label}` {_describe_escapes(leader)}."
    level = [agent for agent in summary.agents if agent is not leader and not is_better(summary, leader, agent)]
    if min(agent.fewest_runs for agent in summary.agents) < FEWEST_RUNS:
        return (f"`{leader.label}` scores highest, but {_count(leader.fewest_runs, 'run')} a room "
                f"{'is' if leader.fewest_runs == 1 else 'are'} too few to be sure.")
    if leader.spec.algorithm == "random" and not level:
        return f"Nothing that learns beats `{leader.label}`, which {_describe_escapes(leader)}."
    if not level:
        return f"`{leader.label}` is best: it {_describe_escapes(leader)}."
    if len(level) > 1:
        return f"No clear winner: `{leader.label}` is ahead, but not clearly of {_count(len(level), 'other')}."
    return f"`{leader.label}` and `{level[0].label}` cannot be told apart; the first {_describe_escapes(leader)}."


def _find_leader(agents: Sequence[AgentSummary]) -> AgentSummary:
    return max(agents, key=lambda agent: agent.score.value)


def _describe_escapes(agent: AgentSummary) -> str:
    """`escapes every time, in 37 primitives`."""
    if agent.success.value == 0:
        return "never escapes"
    if agent.success.value < SETTLED:
        return f"escapes in {agent.success.value:.0%} of episodes"
    often = "every time" if agent.success.value == 1 else f"in {agent.success.value:.1%} of episodes"
    return f"escapes {often}, in {agent.length.value:.0f} primitives"


# --- findings --------------------------------------------------------------------------


def _compare_views(summary: Summary) -> list[str]:
    """With options against without."""
    flat = [agent for agent in summary.agents if not agent.spec.chooses_options]
    hierarchical = [agent for agent in summary.agents if agent.spec.chooses_options]
    if not flat or not hierarchical:
        return []
    best_flat, best = _find_leader(_prefer_learners(flat)), _find_leader(_prefer_learners(hierarchical))
    names = _join([f"`{agent.label}`" for agent in flat])
    if best.success.value > 0 and all(agent.success.value == 0 for agent in flat):
        return [f"Without options nobody escapes: {names} never {'does' if len(flat) == 1 else 'do'} within "
                f"{summary.grid.primitives:,} primitives. With options, `{best.label}` {_describe_escapes(best)}."]
    if is_better(summary, best, best_flat):
        return [f"Options help: {_describe_odds(summary, best, best_flat)}; the first {_describe_escapes(best)}, the "
                f"second {_describe_escapes(best_flat)}."]
    if is_better(summary, best_flat, best):
        return [f"Options do not help here: {_describe_odds(summary, best_flat, best)}; the first "
                f"{_describe_escapes(best_flat)}, the second {_describe_escapes(best)}."]
    return [f"Whether options help cannot be told from these runs: `{best.label}` scores {_describe_score(best)}, "
            f"`{best_flat.label}` {_describe_score(best_flat)}."]


def _prefer_learners(agents: Sequence[AgentSummary]) -> list[AgentSummary]:
    return [agent for agent in agents if agent.spec.algorithm != "random"] or list(agents)


def _compare_with_chance(summary: Summary) -> list[str]:
    """Learners over options against choosing among the same options at random: what learning adds."""
    sentences = []
    for chance in summary.agents:
        if not chance.spec.chooses_options or chance.spec.algorithm != "random":
            continue
        learners = [agent for agent in summary.agents if agent.spec.chooses_options and agent is not chance
                    and agent.spec.options == chance.spec.options and agent.spec.algorithm != "random"]
        if not learners:
            continue
        best = _find_leader(learners)
        start = (f"Choosing among the options at random (`{chance.label}`) already {_describe_escapes(chance)}: that "
                 "much their planners know" if chance.success.value > 0 else
                 f"Choosing among the options at random (`{chance.label}`) never escapes")
        if is_better(summary, best, chance):
            both = min(chance.success.value, best.success.value) >= SETTLED
            gain = f"shortens that to {best.length.value:.0f}" if both else _describe_escapes(best)
            sentences.append(f"{start}. Learning adds to it: `{best.label}` {gain}.")
        elif is_better(summary, chance, best):
            sentences.append(f"{start}. No learner comes up to it: the best, `{best.label}`, "
                             f"{_describe_escapes(best)}.")
        else:
            sentences.append(f"{start}. That learning adds anything is not shown: `{best.label}` scores "
                             f"{_describe_score(best)}, chance {_describe_score(chance)}.")
        worse = [agent for agent in learners if agent is not best and is_better(summary, chance, agent)]
        if worse:
            names = _join([f"`{agent.label}`" for agent in worse])
            sentences.append(f"{names} {'ends' if len(worse) == 1 else 'end'} below choosing at random.")
    return sentences


def _describe_speed(summary: Summary) -> list[str]:
    reached = sorted((found, agent.label) for agent in summary.agents if agent.spec.algorithm != "random"
                     and (found := find_first_reach(agent)) is not None)
    if not reached:
        return []
    when = _join([f"`{label}` after about {found:,.0f} primitives" for found, label in reached])
    return [f"A score of {GOOD_SCORE:g} is first reached by {when} of training."]


def _describe_gap(summary: Summary) -> list[str]:
    leader = _find_leader(summary.agents)
    missing, best = sum(leader.gap), "the best known return"
    if missing <= 0.0005:
        return [f"`{leader.label}` reaches {best}: nothing is missing."]
    if leader.gap.options > 0.0005:
        return [f"Of the way to {best}, {missing:.1%} is missing to `{leader.label}`: {leader.gap.options:.1%} that "
                f"its options cannot do, {max(leader.gap.learning, 0):.1%} that it has not learned."]
    return [f"Of the way to {best}, {missing:.1%} is missing to `{leader.label}`; its actions could do it, so that "
            "much is left to learn."]


def _describe_stuck(summary: Summary) -> list[str]:
    some = [f"{round(agent.stuck * agent.runs)} of {agent.runs} runs of `{agent.label}`"
            for agent in _prefer_learners(summary.agents) if 0 < agent.stuck and agent.success.value > 0]
    return [f"Stuck, without any escape in the last fifth of training: {_join(some)}."] if some else []


def _describe_better_ways(summary: Summary) -> list[str]:
    sentences, labels = [], {agent.label for agent in summary.agents}
    for room in summary.rooms:
        finders = [f"`{source}`" for source in room.source.split(", ") if source in labels]
        if finders:
            sentences.append(f"In {room.name}, {_join(finders)} found a better way than the planners; scores are "
                             f"measured by it ({room.best:g}).")
    return sentences


# --- cautions --------------------------------------------------------------------------


def _write_cautions(summary: Summary) -> list[str]:
    grid, cautions = summary.grid, []
    expected = len(grid.rooms) * grid.runs
    short = [agent for agent in summary.agents if agent.runs < expected]
    if short or len(summary.agents) < len(grid.agents):
        lost = [f"`{agent.label}` {expected - agent.runs} of {expected}" for agent in short]
        known = {agent.label for agent in summary.agents}
        lost += [f"`{spec.label}` all {expected}" for spec in grid.agents if spec.label not in known]
        cautions.append(f"Some runs have no result and count nowhere: {_join(lost)}. Their errors stand below.")
    if grid.runs < PUBLISHED_RUNS:
        cautions.append(f"{_count(grid.runs, 'run').capitalize()} a room: large differences show, small ones may not. "
                        f"A published table needs {PUBLISHED_RUNS} or more.")
    learners = [agent for agent in summary.agents if agent.spec.chooses_options and agent.spec.algorithm != "random"]
    chance = [agent.spec.options for agent in summary.agents
              if agent.spec.chooses_options and agent.spec.algorithm == "random"]
    unmatched = [f"`{agent.label}`" for agent in learners if agent.spec.options not in chance]
    if unmatched:
        cautions.append(f"No random policy over the same options was run beside {_join(unmatched)}, so how much of the "
                        "score the options' planners bring is not known.")
    for room in summary.rooms:
        if CEILING in room.source.split(", "):
            cautions.append(f"No plan is known for {room.name}: its scores are measured by an escape at once, which no "
                            "agent can do.")
        elif PLANNER not in room.source.split(", ") and room.source == "nothing":
            cautions.append(f"No run in {room.name} has a result.")
    mixed = [name for name, version in summary.versions.items() if ", " in version]
    if mixed:
        cautions.append(f"The runs were made with different versions of {_join(mixed)}.")
    return cautions


# --- words -----------------------------------------------------------------------------


def _describe_odds(summary: Summary, first: AgentSummary, second: AgentSummary) -> str:
    odds = summary.get_improvement(first, second)
    return (f"a run of `{first.label}` beats one of `{second.label}` with probability {odds.value:.2f} "
            f"({odds.low:.2f} to {odds.high:.2f})")


def _describe_score(agent: AgentSummary) -> str:
    return f"{agent.score.value:.3f} ({agent.score.low:.3f} to {agent.score.high:.3f})"


def _count(number: int, noun: str) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    word = words[number] if number < len(words) else f"{number:,}"
    return f"{word} {noun}" + ("" if number == 1 else "s")


def _join(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
