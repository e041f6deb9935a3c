"""Options learned over planned presses, placed on a dial of planned options that fail with a known probability.

One call of an option is worth gamma^k if its goal holds after the k primitives that it took, and 0 if not. A planned
option that fails with probability f (`OptionDegradation`) is worth 1 - f times the planned one. So a learned option is
worth a planned option that fails with some probability. A detour counts as a failure would.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import LEVEL, compute_interval
from hrl_escape.benchmark.statistics import LEAST_RUNS, compute_mean
from hrl_escape.errors import ComparisonError
from studies.store import Line
from studies.tables import make_table

__all__ = ["DialLine", "DialPlace", "PlacedOption", "find_best_option", "place_lines", "place_on_dial",
           "tabulate_dial"]

PLANNED = "planned"


@dataclasses.dataclass(frozen=True)
class DialLine(Line):
    """Mean worth of calls of one option.

    Attributes:
        room: name.
        option: `planned`, or the agent's label.
        primitives: that the agent was trained for; 0 of the planned one.
        failure: probability that the planned option fails; None of a learned one.
        seed: of training, or of the planned option's failures.
        worth: mean of gamma^k where the goal holds after the call, else 0.
    """

    room: str
    option: str
    primitives: int
    failure: float | None
    seed: int
    worth: float

    @property
    def place(self) -> tuple[str, str, int, float, int]:
        """Subject of the line."""
        return self.room, self.option, self.primitives, -1.0 if self.failure is None else self.failure, self.seed


class DialPlace(NamedTuple):
    """Place of an option on the dial.

    Attributes:
        failure: probability of failing of a planned option of the same worth, in [0, 1]: 0 for one that is worth
            no less than the planned one.
        low: lower end of its interval.
        high: upper end.
    """

    failure: float
    low: float
    high: float


def place_on_dial(curve: Mapping[float, ArrayLike], worth: ArrayLike, seed: int = 0, level: float = LEVEL
                  ) -> DialPlace:
    """Find how often a planned option must fail to be worth as much as a learned one.

    Args:
        curve: probability of failing -> what calls of the planned option are worth, of as many calls as there are. It
            is made monotone, and linear between its points.
        worth: what the learned option is worth, one number a run.
        seed: fixes the draws of the interval of the mean over runs; the curve counts as known.
        level: confidence of the interval; 1 - 0.05 / n where n options are compared, or the best of n is picked.

    Raises:
        ComparisonError: fewer than two points, or no run.
    """
    scores = np.asarray(worth, np.float64).ravel()
    if len(curve) < 2 or not scores.size:
        raise ComparisonError(f"a place on the dial needs two points and one run, not {len(curve)} and {scores.size}")
    failures = np.array(sorted(curve))
    means = isotonic_regression([np.mean(np.asarray(curve[failure], np.float64)) for failure in failures],
                                increasing=False).x

    def find(value: float) -> float:
        return float(np.interp(value, means[::-1], failures[::-1]))

    low, high = compute_interval(compute_mean, [scores], (0.0, 1.0), np.random.default_rng(seed), level=level)
    return DialPlace(find(float(scores.mean())), find(float(high)), find(float(low)))


class PlacedOption(NamedTuple):
    """An agent's option after some training.

    Attributes:
        option: label of the agent.
        primitives: of training.
        runs: number of them.
        place: on the dial.
    """

    option: str
    primitives: int
    runs: int
    place: DialPlace


def place_lines(lines: Sequence[DialLine], level: float = LEVEL) -> list[PlacedOption]:
    """Place every learned option of the lines, in their order, with intervals of this confidence.

    Raises:
        ComparisonError: the lines have no curve.
    """
    curve, learned = _group(lines)
    return [PlacedOption(*key, len(worth), place_on_dial(curve, worth, level=level)) for key, worth in learned.items()]


def _group(lines: Sequence[DialLine]) -> tuple[dict[float, list[float]], dict[tuple[str, int], list[float]]]:
    """Worth of planned options by their rate of failure, and of learned ones by name and primitives of training."""
    curve: dict[float, list[float]] = defaultdict(list)
    learned: dict[tuple[str, int], list[float]] = defaultdict(list)
    for line in lines:
        if line.failure is None:
            learned[line.option, line.primitives].append(line.worth)
        else:
            curve[line.failure].append(line.worth)
    return curve, learned


def find_best_option(lines: Sequence[DialLine]) -> PlacedOption | None:
    """Best option after all training, or None without an agent that has `LEAST_RUNS` runs.

    Intervals hold together for the options of all agents, so also for the best of them (Bonferroni).

    Raises:
        ComparisonError: the lines have no curve, or no learned option.
    """
    _, learned = _group(lines)
    if not learned:
        raise ComparisonError("no learned option was measured")
    last = max(primitives for _, primitives in learned)
    chosen = {key for key, worth in learned.items() if len(worth) >= LEAST_RUNS and key[1] == last}
    return min((option for option in place_lines(lines, 1 - (1 - LEVEL) / max(len(chosen), 1))
                if option[:2] in chosen), key=lambda option: option.place, default=None)


def tabulate_dial(lines: Sequence[DialLine]) -> str:
    """Table of all places, by agent and primitives of training."""
    placed = place_lines(sorted(lines, key=lambda line: line.place))
    budgets = sorted({option.primitives for option in placed})
    cells = {option[:2]: f"{place.failure:.0%} ({place.low:.0%} to {place.high:.0%})"
             for option in placed for place in [option.place]}
    return make_table(["option of", *(f"{budget:,} primitives" for budget in budgets)], [
        [AgentSpec.parse(name).title, *(cells.get((name, budget), "-") for budget in budgets)]
        for name in dict.fromkeys(option.option for option in placed)])
