"""Verdict of a comparison in sentences.

Pure functions from a `Summary` to sentences. An agent is called better than another only if a paired test is
significant after correction for all pairs of agents (`inference.py`). With fewer than `LEAST_RUNS` pairs of runs the
sentences give estimates and intervals only. Labels of agents are between backticks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.inference import is_better
from hrl_escape.benchmark.measures import RETURN
from hrl_escape.benchmark.references import registry as references
from hrl_escape.benchmark.score_range import CEILING
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.benchmark.summary import AgentSummary, Summary
from hrl_escape.names import join_words
from hrl_escape.notebook import mark_labels

MOST_LABELS = 4
"""Largest number of agents in a headline."""
SENTENCE_MARKS = {"headline": "", "finding": "- ", "caution": "! "}
"""Marks before the kinds of sentences, in text."""
SETTLED = 0.9
"""Smallest success rate of agents whose primitives of an escape are compared."""


@dataclass(frozen=True)
class Sentence:
    """Sentence of the verdict."""

    kind: Literal["headline", "finding", "caution"]  # the headline, a finding that supports it, or a caution
    text: str  # plain words; labels of agents between backticks


class Verdict(list[Sentence]):
    """Sentences of a verdict: one headline, then findings, then cautions. Notebooks show them as a list."""

    def __repr__(self) -> str:
        return "\n".join(f"{SENTENCE_MARKS[each.kind]}{each.text}" for each in self)

    def _repr_html_(self) -> str:
        head, *others = (mark_labels(each.text) for each in self)
        cautions = [each.kind == "caution" for each in self[1:]]
        rows = "".join(f"<li>{'<b>Caution.</b> ' if is_caution else ''}{text}</li>"
                       for text, is_caution in zip(others, cautions, strict=True))
        return f"<p><b>{head}</b></p><ul>{rows}</ul>"


def write_verdict(summary: Summary) -> Verdict:
    """Write the verdict: one headline, then findings, then cautions."""
    findings = [*_compare_views(summary), *_compare_with_random(summary), *_compare_with_search(summary),
                *_describe_generalisation(summary), *_describe_trials(summary), *_describe_speed(summary),
                *_describe_gap(summary), *_describe_stuck(summary), *_describe_better_ways(summary)]
    return Verdict([Sentence("headline", _write_headline(summary)), *(Sentence("finding", text) for text in findings),
                    *(Sentence("caution", text) for text in _write_cautions(summary))])


def find_leader(agents: Sequence[AgentSummary]) -> AgentSummary:
    """Return the agent with the highest final value; the oracle only if it is alone."""
    contenders = [agent for agent in agents if agent.spec.name != references.ORACLE] or agents
    return max(contenders, key=lambda agent: agent.primary.value)


def _beats(summary: Summary, first: AgentSummary, second: AgentSummary) -> bool:
    return is_better(summary.get_pair(first, second))


# --- headline --------------------------------------------------------------------------


def _write_headline(summary: Summary) -> str:
    contenders = [agent for agent in summary.agents if agent.spec.name != references.ORACLE]
    leader = find_leader(summary.agents)
    if leader.success.value == 0:
        return f"No agent {summary.measure.verb}s within {summary.grid.primitives:,} primitives of training."
    if len(contenders) < 2:
        return f"`{leader.label}` {_describe_end(summary, leader)}."
    others = sorted((agent for agent in contenders if agent is not leader), key=lambda agent: -agent.primary.value)
    measure = summary.measure
    tied = [leader, *(agent for agent in others if _tie(summary, leader, agent))]
    if any(_has_few(summary, leader, agent) for agent in others):
        highest = f"the highest {measure.name}, {measure.describe(leader.primary)}"
        most = f"`{leader.label}` has {highest}" if len(tied) == 1 else f"{_join_labels(tied)} have {highest}"
        return (f"{most}. {count_things(leader.fewest_runs, 'run').capitalize()}{_get_place(summary)} "
                f"{'is' if leader.fewest_runs == 1 else 'are'} too few for a verdict, which takes {LEAST_RUNS}.")
    level = [agent for agent in others if not _beats(summary, leader, agent) and agent not in tied]
    if not level and len(tied) == 1:
        learners = any(agent.spec.learns for agent in others)
        end = _describe_end(summary, leader)
        return (f"`{leader.label}` is best: it {end}." if leader.spec.learns or not learners else
                f"No learner matches `{leader.label}`, which {end}.")
    if len(tied) == 1:
        return (f"No significant difference between {_join_labels([leader, *level])}; the first "
                f"{_describe_end(summary, leader)}.")
    tie = (f"{_join_labels(tied)} tie at {measure.article} {measure.name} of "
           f"{measure.format(leader.primary.value)}")
    return f"{tie}, with no significant difference from {_join_labels(level)}." if level else (
        f"{tie}: `{leader.label}` {_describe_end(summary, leader)}.")


def _tie(summary: Summary, first: AgentSummary, second: AgentSummary) -> bool:
    """Return whether two agents have the same value as printed without a significant difference."""
    values = (summary.measure.format(agent.primary.value) for agent in (first, second))
    return (len(set(values)) == 1 and not _beats(summary, first, second)
            and not _beats(summary, second, first))


def _has_few(summary: Summary, first: AgentSummary, second: AgentSummary) -> bool:
    """Return whether two agents have too few common runs for a verdict."""
    return summary.get_pair(first, second).count < LEAST_RUNS


def _join_labels(agents: Sequence[AgentSummary]) -> str:
    """Join labels; of more than four the first three and the number of others."""
    labels = [f"`{agent.label}`" for agent in agents]
    if len(labels) > MOST_LABELS:
        labels = [*labels[:MOST_LABELS - 1], count_things(len(labels) - MOST_LABELS + 1, "other")]
    return join_words(labels)


def _describe_end(summary: Summary, agent: AgentSummary) -> str:
    """`escapes every time, in 37 primitives`; elsewhere `succeeds every time` or `has a return of 92.1`."""
    verb = summary.measure.verb
    if summary.measure is RETURN:
        return f"has a return of {RETURN.describe(agent.primary)}"
    if agent.success.value == 0:
        return f"never {verb}s"
    if agent.success.value < SETTLED:
        return f"{verb}s in {agent.success.value:.0%} of episodes"
    often = "every time" if agent.success.value == 1 else f"in {agent.success.value:.1%} of episodes"
    return f"{verb}s {often}, in {agent.length.value:.0f} primitives"


def _get_place(summary: Summary) -> str:
    """` a room` after a number of runs, or nothing in one environment."""
    return " a room" if summary.grid.env is None else ""


# --- findings --------------------------------------------------------------------------


def _compare_views(summary: Summary) -> list[str]:
    """Compare agents with options and without."""
    policies = [agent for agent in summary.agents if not (agent.spec.is_reference or agent.spec.low_level)]
    flat = [agent for agent in policies if not agent.spec.chooses_options]
    hierarchical = [agent for agent in policies if agent.spec.chooses_options]
    if not flat or not hierarchical:
        return []
    best_flat, best = find_leader(_prefer_learners(flat)), find_leader(_prefer_learners(hierarchical))
    names = join_words([f"`{agent.label}`" for agent in flat])
    if best.success.value > 0 and all(agent.success.value == 0 for agent in flat):
        return [f"Without options no agent {summary.measure.verb}s: {names} never "
                f"{'does' if len(flat) == 1 else 'do'} within "
                f"{summary.grid.primitives:,} primitives. With options, `{best.label}` {_describe_end(summary, best)}."]
    with_options, without = _describe_end(summary, best), _describe_end(summary, best_flat)
    if _beats(summary, best, best_flat):
        return [f"Options help: {_describe_odds(summary, best, best_flat)}; the first {with_options}, the second "
                f"{without}."]
    if _beats(summary, best_flat, best):
        return [f"Options do not help here: {_describe_odds(summary, best_flat, best)}; the first {without}, the "
                f"second {with_options}."]
    return [f"With options against without: {_describe_even(summary, best, best_flat)}."]


def _prefer_learners(agents: Sequence[AgentSummary]) -> list[AgentSummary]:
    return [agent for agent in agents if agent.spec.learns] or list(agents)


def _compare_with_random(summary: Summary) -> list[str]:
    """Compare learners over options with the random policy over the same options.

    A learner improves on it only if it also beats the best search baseline.
    """
    sentences, plans = [], summary.grid.env is None
    for baseline in summary.agents:
        if not baseline.spec.chooses_options or baseline.spec.algorithm != "random":
            continue
        learners = [agent for agent in summary.agents if agent.spec.chooses_options and agent is not baseline
                    and _get_choices(agent) == _get_choices(baseline) and agent.spec.learns]
        if not learners:
            continue
        best = find_leader(learners)
        start = (f"Random choice among the options (`{baseline.label}`) {_describe_end(summary, baseline)}"
                 f"{': that much comes from their planners' if plans and baseline.success.value > 0 else ''}.")
        if _beats(summary, best, baseline):
            both = summary.measure is not RETURN and min(baseline.success.value, best.success.value) >= SETTLED
            gain = f"shortens that to {best.length.value:.0f}" if both else _describe_end(summary, best)
            searches = _list_search_baselines(summary)
            adds = "Learning adds to it: " if searches and _beats(summary, best, find_leader(searches)) else ""
            sentences.append(f"{start} {adds}`{best.label}` {gain}.")
        elif _beats(summary, baseline, best):
            sentences.append(f"{start} No learner matches it: the best, `{best.label}`, "
                             f"{_describe_end(summary, best)}.")
        else:
            sentences.append(f"{start} Best learner against it: {_describe_even(summary, best, baseline)}.")
        worse = [agent for agent in learners if agent is not best and _beats(summary, baseline, agent)]
        if worse:
            names = join_words([f"`{agent.label}`" for agent in worse])
            sentences.append(f"{names} {'ends' if len(worse) == 1 else 'end'} below choosing at random.")
    return sentences


def _list_search_baselines(summary: Summary) -> list[AgentSummary]:
    return [agent for agent in summary.agents if agent.spec.name in references.SEARCH_BASELINES]


def _compare_with_search(summary: Summary) -> list[str]:
    """Compare learners over options or hierarchies with the best search baseline."""
    learners = [agent for agent in summary.agents
                if (agent.spec.chooses_options or agent.spec.low_level) and agent.spec.learns]
    baselines = _list_search_baselines(summary)
    if not learners or not baselines:
        return []
    best, baseline = find_leader(learners), find_leader(baselines)
    rule = references.describe_rule(baseline.spec.name)
    name = "search baseline" if len(baselines) == 1 else "best search baseline"
    start = (f"The {name}, `{baseline.label}`, {_describe_end(summary, baseline)}. It {rule}"
             + ("" if baseline.spec.name == references.SEARCH_MEMORY else ", and forgets everything after an episode"))
    if _beats(summary, best, baseline):
        return [f"{start}; `{best.label}`, trained in {_name_rooms(summary)}, is better."]
    if _beats(summary, baseline, best):
        return [f"{start}; no learner matches that."]
    return [f"{start}. Best learner against it: {_describe_even(summary, best, baseline)}."]


def _name_rooms(summary: Summary) -> str:
    return "other rooms" if summary.grid.train_rooms else "this room" if len(summary.rooms) == 1 else "the same room"


def _describe_speed(summary: Summary) -> list[str]:
    """Compare first escapes in training; runs without one count with the budget."""
    learners = sorted((agent.first_escape.value, agent.label, agent) for agent in summary.agents
                      if agent.spec.learns and agent.escaped_runs)
    if not learners:
        return []
    verb, noun = summary.measure.verb, summary.measure.noun
    when = join_words([f"`{label}` after {value:,.0f} primitives ({agent.escaped_runs} of {agent.runs} runs {verb})"
                       for value, label, agent in learners])
    return [f"First {noun} in training, on average, with runs that never {verb} counted at the budget: {when}."]


def _describe_gap(summary: Summary) -> list[str]:
    leader = find_leader(summary.agents)
    if summary.grid.env is not None:
        reference, reached = summary.grid.env.reference, RETURN.describe(leader.returns)
        return [] if reference is None else [
            f"The reference return is {RETURN.format(reference)}; `{leader.label}` has {reached}."]
    missing = sum(leader.gap)
    if missing <= 0.0005:
        return [f"`{leader.label}` is as efficient as the best known escape."]
    way = f"`{leader.label}` has an efficiency of {leader.efficiency.value:.3f}, where the best known escape has 1"
    if leader.gap.options > 0.0005:
        return [f"{way}; of the rest, {leader.gap.options:.3f} is out of reach of its options and "
                f"{max(leader.gap.learning, 0):.3f} is left to learn."]
    if leader.spec.low_level == "planned":
        return [f"{way}; how much of the rest its planned low level put out of reach was not measured."]
    return [f"{way}; its actions can reach that."]


def _describe_stuck(summary: Summary) -> list[str]:
    some = [f"{agent.stuck_runs} of {agent.runs} runs of `{agent.label}`"
            for agent in _prefer_learners(summary.agents) if 0 < agent.stuck and agent.success.value > 0]
    return [f"No {summary.measure.noun} in the last fifth of training: {join_words(some)}."] if some else []


def _describe_generalisation(summary: Summary) -> list[str]:
    """Compare efficiency in test rooms and in training rooms."""
    learners = [(agent, agent.seen) for agent in summary.agents if agent.spec.learns and agent.seen is not None]
    if not learners:
        return []
    words = [f"`{agent.label}` {agent.efficiency.value:.2f} against {seen.value:.2f}" for agent, seen in learners]
    return [f"Efficiency in test rooms against training rooms: {join_words(words)}."]


def _describe_trials(summary: Summary) -> list[str]:
    tried = [agent for agent in summary.agents if agent.trials]
    if not tried:
        return []
    words = [f"`{agent.label}` {', '.join(f'{trial.value:.2f}' for trial in agent.trials)}" for agent in tried]
    sentences = [f"Efficiency trial by trial in the same unseen rooms, without learning: {'; '.join(words)}."]
    forgetful = [f"`{agent.label}`" for agent in tried if not agent.spec.remembers]
    if forgetful:
        sentences.append(f"No memory, so the same policy at every trial: {join_words(forgetful)}.")
    return sentences


def _describe_better_ways(summary: Summary) -> list[str]:
    sentences, labels = [], {agent.label for agent in summary.agents if agent.spec.name != references.ORACLE}
    for room in summary.rooms:
        finders = [f"`{source}`" for source in room.source.split(", ") if source in labels]
        if finders:
            sentences.append(f"In {room.name}, {join_words(finders)} found a better way than the planners; efficiency "
                             f"is measured by it ({room.fewest:g} primitives).")
    return sentences


# --- cautions --------------------------------------------------------------------------


def _write_cautions(summary: Summary) -> list[str]:
    grid, cautions = summary.grid, []
    expected = len(summary.rooms) * grid.runs
    short = [agent for agent in summary.agents if agent.runs < expected]
    if short or len(summary.agents) < len(grid.agents):
        lost = [f"`{agent.label}` {expected - agent.runs} of {expected}" for agent in short]
        known = {agent.label for agent in summary.agents}
        lost += [f"`{spec.label}` all {expected}" for spec in grid.agents if spec.label not in known]
        cautions.append(f"Some runs have no result and count nowhere: {join_words(lost)}. Their errors stand below.")
    if grid.runs < LEAST_RUNS:
        more = f"`--runs {LEAST_RUNS}`" if grid.env is None else f"`--runs {LEAST_RUNS}` or `seeds={LEAST_RUNS}`"
        cautions.append(f"{count_things(grid.runs, 'run').capitalize()}{_get_place(summary)}: with {more} the same "
                        "command continues these runs, to a verdict.")
    if grid.env is not None:
        cautions.append(f"Intervals and tests are over training seeds in {summary.rooms[0].name} alone. They say "
                        "nothing about other environments.")
    cautions += tell_privileges(agent.spec for agent in summary.agents)
    learners = [agent for agent in summary.agents if agent.spec.chooses_options and agent.spec.learns]
    covered = [_get_choices(agent) for agent in summary.agents
               if agent.spec.chooses_options and agent.spec.algorithm == "random"]
    unmatched = [f"`{agent.label}`" for agent in learners if _get_choices(agent) not in covered]
    if unmatched:
        brought = "the options' planners" if grid.env is None else "the options"
        cautions.append(f"No random policy over the same options was run for {join_words(unmatched)}, so the share of "
                        f"the score that {brought} bring is unknown.")
    bar = references.SEARCH_BACKTRACK if grid.train_rooms else references.SEARCH_MEMORY
    searches = (*references.SEARCH_METHODS, references.SEARCH_MEMORY)
    has_search = any(agent.spec.name in searches for agent in summary.agents)
    if grid.env is None and learners and not has_search:
        cautions.append(f"No search baseline such as `{bar}` was run, so what can be reached without learning is "
                        "unknown.")
    for room in summary.rooms:
        if room.place.split is not None and (known := room.place.split.room_overlap):
            cautions.append(f"{known:.0%} of the test rooms of {room.name} are training rooms too, so efficiency there "
                            "is not efficiency in unseen rooms.")
        if CEILING in room.source.split(", "):
            cautions.append(f"No plan is known for {room.name}: its scores are measured by an escape at once, which no "
                            "agent can do, so efficiency there is near 0.")
        elif room.source == "nothing":
            cautions.append(f"No run in {room.name} has a result.")
    mixed = [name for name, version in summary.versions.items() if ", " in version]
    if mixed:
        cautions.append(f"The runs were made with different versions of {join_words(mixed)}.")
    return cautions


def _get_choices(agent: AgentSummary) -> OptionsView:
    """Return the options of an agent without its memory."""
    return dataclasses.replace(agent.spec.options, memory=False)


# --- words -----------------------------------------------------------------------------


def _describe_even(summary: Summary, first: AgentSummary, second: AgentSummary) -> str:
    """Describe two agents without a significant difference."""
    measure = summary.measure
    values = (f"`{first.label}` has {measure.article} {measure.name} of {measure.describe(first.primary)}, "
              f"`{second.label}` of {measure.describe(second.primary)}")
    return values if _has_few(summary, first, second) else f"no significant difference; {values}"


def _describe_odds(summary: Summary, first: AgentSummary, second: AgentSummary) -> str:
    pair, measure = summary.get_pair(first, second), summary.measure
    where = "room and seed" if summary.grid.env is None else "seed"
    return (f"`{first.label}` {measure.better} `{second.label}` by {measure.describe(pair.difference)} with the "
            f"same {where}, in {pair.improvement.value:.0%} of {pair.count} pairs")


def tell_privileges(agents: Iterable[AgentSpec]) -> list[str]:
    """Describe the privileged information of agents with hierarchies."""
    told = [f"`{agent.label}` ({', '.join(agent.privileges)})" for agent in agents if agent.privileges]
    return [f"Privileged, by a hierarchy that is synthesised from the room: {join_words(told)}."] if told else []


def count_things(number: int, noun: str) -> str:
    """Format number and noun in a sentence: `no runs`, `one run`, `two runs`, `10 runs`."""
    return f"{spell_number(number)} {noun}" + ("" if number == 1 else "s")


def spell_number(number: int) -> str:
    """Format a number in a sentence: `no`, `one`, `two`, `10`."""
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[number] if number < len(words) else f"{number:,}"
