"""Sentences on generalisation, by rule from the lines of the runs: agents against each other, and sizes and depths.

Runs are paired by their training seed. Only cells of `LEAST_RUNS` seeds or more are asked about, and the questions of
one table share Holm's correction.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.names import count_nouns, join_words
from studies.baseline import BaselineRun
from studies.generalisation.grids import CEILING, DEPTHS, FLAT, FLAT_CHANCE, SEARCH_BASELINES
from studies.statistics import choose_holm_levels, find_visible_difference

__all__ = ["advise", "tell_best", "tell_puzzle_depths", "tell_room_numbers"]

_Seeds = Mapping[int, float]
"""Efficiency in unseen rooms by training seed."""
_Place = TypeVar("_Place", bound=Hashable)
_RANDOM = {FLAT_CHANCE: "random primitives"}


class _Question(NamedTuple):
    """Two conditions, in words, and the efficiencies of the first less those of the second, (seeds,)."""

    first: str
    second: str
    differences: NDArray[np.float64]


def tell_best(cells: Mapping[tuple[str, int], Sequence[BaselineRun]], agents: Sequence[str]) -> str:
    """One sentence on one rung: learners in unseen rooms against the best searcher that learns nothing.

    Every cell of a learner is asked about, and all of them are one family (Holm): the best of several cells is no
    finding that one alone would be.

    Args:
        cells: runs by agent and number of training rooms.
        agents: the learners.

    Returns:
        The sentence; empty without a cell of `LEAST_RUNS` seeds of either.
    """
    enough = _keep_enough(cells)
    learned = {place: seeds for place, seeds in enough.items() if place[0] in agents}
    searched = {place: seeds for place, seeds in enough.items() if place[0] in SEARCH_BASELINES}
    if not learned or not searched:
        return ""
    searcher = max(searched, key=lambda place: _mean(searched[place]))
    theirs = searched[searcher]
    gains = {place: _subtract(ours, theirs) for place, ours in learned.items()}
    p = [compare_pairs([gain]).p for gain in gains.values()]
    levels = dict(zip(gains, choose_holm_levels(p), strict=True))
    corrected = dict(zip(gains, correct_by_holm(p), strict=True))
    beating = [place for place in gains if corrected[place] < ALPHA and gains[place].mean() > 0]
    behind = [place for place in gains if corrected[place] < ALPHA and gains[place].mean() < 0]
    best = agent, count = max(beating or learned, key=lambda place: _mean(learned[place]))
    test = compare_pairs([gains[best]], levels[best])
    run = cells[best][0]
    rooms = (f"at its best number of training rooms, {count:,}," if sum(other == agent for other, _ in learned) > 1 else
             f"with {_count(count)}")
    words = (f"`{agent}` {rooms} reaches {_mean(learned[best]):.2f} in {count_nouns(run.episodes, 'unseen room')}, the "
             f"best searcher that learns nothing, `{searcher[0]}`, {_mean(theirs):.2f} ({test.difference:+.2f}, "
             f"{test.low:+.2f} to {test.high:+.2f} over training seeds in these rooms)")
    visible = find_visible_difference([gains[best]], ALPHA / len(gains))
    limit = "".join(f" The Bayes planner, `{name}`, is given how graphs are drawn and has {_mean(seeds):.2f}."
                    for (name, _), seeds in enough.items() if name in CEILING)
    if beating:
        return (f"In these rooms of `{run.rung}`, training pays beyond searching in {len(beating)} of {len(gains)} "
                f"cells: {words}.{limit}")
    if len(behind) == len(gains):
        return f"No learner matches searching in `{run.rung}`: {words} at best.{limit}"
    return (f"No learner is shown to beat searching in `{run.rung}`: {words} at best; a study of this size has 80 % "
            f"power to detect a gain of {visible:.2f}.{limit}")


def advise(cells: Mapping[tuple[str, int], Sequence[BaselineRun]], learner: str, without: str) -> str:
    """Advice to a user: whether a memory or more training rooms bring more, as one family of two (Holm).

    Args:
        cells: runs by agent and number of training rooms.
        learner: with a memory of its episode.
        without: the same without one.
    """
    enough = _keep_enough(cells)
    counts = sorted(count for agent, count in enough if agent == learner and (without, count) in enough)
    if len(counts) < 2:
        return ""
    gains = {"a memory of its episode": _subtract(enough[learner, counts[-1]], enough[without, counts[-1]]),
             "more training rooms": _subtract(enough[learner, counts[-1]], enough[learner, counts[0]])}
    p = correct_by_holm([compare_pairs([gain]).p for gain in gains.values()])
    shown = [(f"{name} ({gain.mean():+.2f})", gain.mean()) for (name, gain), corrected in
             zip(gains.items(), p, strict=True) if corrected < ALPHA and gain.mean() > 0]
    words = [name for name, _ in sorted(shown, key=lambda part: -part[1])]
    if not words:
        return "Neither a memory of its episode nor more training rooms are shown to help a generalist."
    return f"Give a generalist {words[0]}{f' before {words[1]}' if len(words) > 1 else ''}."


def tell_room_numbers(cells: Mapping[tuple[str, int], Sequence[BaselineRun]], agents: Sequence[str],
                      chances: Mapping[str, str]) -> list[str]:
    """Sentences on one rung: each agent against the one before it, against searching, and many rooms against few.

    Where no searcher was run, and of agents over primitives, against chance.

    An agent that escapes in no test is told of alone: how far others stand above a floor depends on the budget.

    Args:
        cells: runs by agent and number of training rooms.
        agents: in the order of what they are given.
        chances: the agent that chooses at random among the same; how many rooms it trained in makes no difference to
            it.
    """
    enough = _keep_enough(cells)
    chance = {agent: seeds for (agent, _), seeds in reversed(enough.items())}
    searcher = max((agent for agent in SEARCH_BASELINES if agent in chance), key=lambda agent: _mean(chance[agent]),
                   default=None)
    known = [agent for agent in agents if any(agent == other for other, _ in enough)]
    tests = {agent: {count: cells[agent, count] for other, count in enough if other == agent} for agent in known}
    told = {agent: _tell_zero(agent, tests[agent]) for agent in known
            if not any(run.efficiency for runs in tests[agent].values() for run in runs)}
    known, asked = [agent for agent in known if agent not in told], []
    for before, agent in zip((None, *known), known, strict=False):
        own = sorted(count for other, count in enough if other == agent)
        most = enough[agent, own[-1]]
        both = [count for count in own if (before, count) in enough] if before is not None else []
        if before is not None and both:
            asked.append(_ask(f"`{agent}` with {_count(both[-1])}", f"`{before}`",
                              enough[agent, both[-1]], enough[before, both[-1]]))
        if searcher is not None and agent != FLAT:
            asked.append(_ask(f"`{agent}` with {_count(own[-1])}", f"the best searcher, `{searcher}`,",
                              most, chance[searcher]))
        elif (by_chance := chance.get(chances[agent])) is not None:
            asked.append(_ask(f"`{agent}` with {_count(own[-1])}", _RANDOM.get(chances[agent], "random choices"),
                              most, by_chance))
        if len(own) > 1:
            asked.append(_ask(f"`{agent}` with {_count(own[-1])}", f"with {_count(own[0])}", most,
                              enough[agent, own[0]]))
    return [*told.values(), *_answer(asked)]


def _tell_zero(agent: str, tests: Mapping[int, Sequence[BaselineRun]]) -> str:
    """Sentence on an agent that escapes from no unseen room, by numbers of training rooms."""
    runs = [run for own in tests.values() for run in own]
    seen = max((run.seen for run in runs if run.seen is not None), default=0.0)
    also = "nor from one trained in" if not seen else f"though in rooms trained in a run reaches up to {seen:.2f}"
    return (f"`{agent}` escapes from no unseen room after any of its {count_nouns(len(runs), 'run')}, trained in "
            f"{join_words((f'{count:,}' for count in sorted(tests)), 'or')} rooms, {also}. At this floor no difference "
            "from it is asked for.")


def tell_puzzle_depths(cells: Mapping[tuple[str, str], Sequence[BaselineRun]], agents: Sequence[str], chance: str
                       ) -> list[str]:
    """Sentences on deeper puzzles: of each agent, a chain against layers at the same number, and most against fewest.

    And each against the best searcher in every kind of room, or against chance where no searcher was run.

    Args:
        cells: runs by agent and kind of room tested in, of `DEPTHS`.
        agents: those to be asked about.
        chance: the agent that chooses at random.
    """
    enough = _keep_enough(cells)
    layered, chain, *_, deepest = DEPTHS
    asked = []
    for agent in agents:
        asked += [_ask(f"`{agent}` in rooms of {first}", f"in rooms of {second}", enough[agent, first],
                       enough[agent, second])
                  for first, second in ((chain, layered), (deepest, layered))
                  if (agent, first) in enough and (agent, second) in enough]
        for kind in DEPTHS:
            searchers = [name for name in SEARCH_BASELINES if (name, kind) in enough]
            other = max(searchers, key=lambda name: _mean(enough[name, kind]), default=chance)
            if (agent, kind) in enough and (other, kind) in enough:
                words = f"the best searcher, `{other}`," if searchers else "random choices"
                asked.append(_ask(f"`{agent}` in rooms of {kind}", words, enough[agent, kind], enough[other, kind]))
    return _answer(asked)


def _keep_enough(cells: Mapping[_Place, Sequence[BaselineRun]]) -> dict[_Place, _Seeds]:
    """Cells of `LEAST_RUNS` seeds or more."""
    return {place: seeds for place, runs in cells.items() if len(seeds := _index(runs)) >= LEAST_RUNS}


def _subtract(ours: _Seeds, theirs: _Seeds) -> NDArray[np.float64]:
    """Differences at the seeds that both have, (seeds,)."""
    return np.array([ours[seed] - theirs[seed] for seed in sorted(ours.keys() & theirs.keys())])


def _mean(seeds: _Seeds) -> float:
    return float(np.mean([*seeds.values()]))


def _index(runs: Sequence[BaselineRun]) -> _Seeds:
    return {run.seed: run.efficiency for run in runs}


def _count(rooms: int) -> str:
    return f"{rooms:,} training room{'s' if rooms != 1 else ''}"


def _ask(first: str, second: str, ours: _Seeds, theirs: _Seeds) -> _Question:
    return _Question(first, second, _subtract(ours, theirs))


def _answer(asked: Sequence[_Question]) -> list[str]:
    """One sentence a question with enough pairs."""
    asked = [question for question in asked if len(question.differences) >= LEAST_RUNS]
    found = [compare_pairs([question.differences]).p for question in asked]
    told = []
    for question, p, level in zip(asked, correct_by_holm(found), choose_holm_levels(found), strict=True):
        test = compare_pairs([question.differences], level)
        low, high = test.low, test.high
        if p < ALPHA:
            words = f"reaches {abs(test.difference):.2f} {'more' if test.difference > 0 else 'less'}"
            low, high = sorted((abs(low), abs(high)))  # both of the same sign, for the question is answered
        else:
            words = "is not shown to reach more or less"
        told.append(f"{question.first} {words} than {question.second} ({low:.2f} to {high:.2f}).")
    return told
