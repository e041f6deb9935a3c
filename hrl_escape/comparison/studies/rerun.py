"""Departures of the new runs from the published program when it was rerun, told from the numbers by rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hrl_escape.comparison.studies.claims import META_DECISIONS, ONE, TWO
from hrl_escape.comparison.studies.measures import Results, get_runs
from hrl_escape.comparison.studies.raw import BINS, RawRun
from hrl_escape.names import join_words

__all__ = ["RERUN", "Rerun", "tell_departures"]

APART = 0.25
"""Difference of shares of episodes from which on the two are said to part."""


@dataclass(frozen=True)
class Rerun:
    """Escapes of the published program in the last fifth of training, its simulation stepped in lockstep.

    Attributes:
        figure: grid of the same experiment.
        agent: label of the same agent there.
        words: experiment, in words.
        shares: share of escaping episodes in the last fifth, one a run.
        note: what else its runs showed; may be empty.
    """

    figure: str
    agent: str
    words: str
    shares: tuple[float, ...]
    note: str = ""


RERUN = (
    Rerun(META_DECISIONS, "smdp-dqn@paper", "dqn with meta-actions", (1.0, 0.88, 1.0),
          "returns of its runs ended at -5, -248 and 28, and fell on the way in two of three"),
    Rerun(META_DECISIONS, "smdp-sarsa@paper", "sarsa with meta-actions", (0.0, 0.0, 0.0),
          "in wall-clock time, as published, one run ended at 1.00: there it does not decay"),
    Rerun(META_DECISIONS, "smdp-ddpg@paper", "ddpg with meta-actions", (0.0, 0.0)),
    Rerun(TWO, "dqn@paper", "dqn without meta-actions, two buttons", (0.0, 0.14)),
    Rerun(TWO, "sarsa@paper", "sarsa without meta-actions, two buttons", (0.0, 0.0)),
    Rerun(TWO, "ddpg@paper", "ddpg without meta-actions, two buttons", (0.0, 0.0)),
    Rerun(ONE, "dqn@paper", "dqn, one button at 10 m", (0.58, 0.97)),
    Rerun(ONE, "sarsa@paper", "sarsa, one button at 10 m", (0.0,)),
    Rerun(ONE, "ddpg@paper", "ddpg, one button at 10 m", (0.0,)),
)
"""Without meta-actions a share is that of all episodes of a run."""


def tell_departures(results: Results) -> list[str]:
    """A sentence for each experiment: whether the new runs part from the rerun, with both numbers."""
    parted, alike = [], []
    for rerun in RERUN:
        ours = [_compute_late_share(run) for run in get_runs(results, rerun.figure, rerun.agent)]
        there, here = float(np.mean(rerun.shares)), float(np.mean(ours))
        shares = join_words(f"{share:.2f}" for share in rerun.shares)
        sentence = (f"- {rerun.words}: {shares} there, {here:.2f} on average here "
                    f"({min(ours):.2f} to {max(ours):.2f}, {len(ours)} runs){rerun.note and '; '}{rerun.note}.")
        (parted if abs(there - here) > APART else alike).append(sentence)
    return [f"Share of training episodes in the last fifth that escape. Means more than {APART:g} apart:", "",
            *(parted or ["- none."]), "", "Closer than that:", "", *(alike or ["- none."])]


def _compute_late_share(run: RawRun) -> float:
    late = slice(BINS * 4 // 5, BINS)
    return sum(run.training_successes[late]) / max(sum(run.episodes[late]), 1)
