"""The claims of Menashe and Stone (2019), section 6, each with the measurement that tests it.

A claim is tested agent by agent on runs with the paper's recipe; beside it stand the same measurement with the
corrected recipe, and what the published program gave when it was rerun.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hrl_escape.experiments.studies.measures import (
    Results,
    estimate,
    estimate_final,
    estimate_gain,
    estimate_share_of_runs,
    estimate_slope,
    get_runs,
    has_escaped_by,
    has_settled,
    share_of_training,
)
from hrl_escape.experiments.studies.raw import RawRun
from hrl_escape.experiments.summary import Estimate

__all__ = ["CLAIMS", "Claim", "Finding", "FIGURES", "name_agent", "judge_claim"]

FIGURES = ("paper-figure-1", "paper-figure-2", "paper-figure-3", "paper-figure-3-decisions")
ONE, TWO, META, META_DECISIONS = FIGURES
ALL = ("dqn", "sarsa", "ddpg")
EARLY = 2_000
"""Primitives; a tenth of a run."""


class Criterion(NamedTuple):
    """When an estimate bears a claim out.

    Attributes:
        words: where its interval must lie.
        judge: whether it does; None where the interval leaves it open.
    """

    words: str
    judge: Callable[[Estimate], bool | None]


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        says: what the paper says, shortened.
        measured: what is measured, in words.
        figure: the grid in which.
        agents: algorithms it is about.
        compute: the measurement, from (results, agent's label).
        holds: when an estimate bears the claim out.
        unit: `%`, or `points` for differences and slopes of a score in per cent.
        rerun: what the published program gave when rerun.
    """

    says: str
    measured: str
    figure: str
    agents: tuple[str, ...]
    compute: Callable[[Results, str], Estimate]
    holds: Criterion
    unit: str
    rerun: str


@dataclass(frozen=True)
class Finding:
    """What came of a claim.

    Attributes:
        claim: which.
        paper: algorithm -> estimate with the paper's recipe.
        corrected: algorithm -> estimate with the corrected recipe; empty where it was not run.
        verdicts: algorithm -> whether the paper's recipe bears it out.
    """

    claim: Claim
    paper: dict[str, Estimate]
    corrected: dict[str, Estimate]
    verdicts: dict[str, bool | None]

    @property
    def agrees(self) -> str:
        """`yes`, `no`, `open`, or for whom which."""
        kinds = {True: "yes", False: "no", None: "open"}
        if len(set(self.verdicts.values())) == 1:
            return kinds[next(iter(self.verdicts.values()))]
        parts = [(word, [name for name, verdict in self.verdicts.items() if verdict is kind])
                 for kind, word in kinds.items()]
        return "; ".join(f"{word}: {', '.join(names)}" for word, names in parts if names)


def name_agent(algorithm: str, recipe: str, figure: str) -> str:
    """An agent's label in a figure's grid."""
    prefix = "smdp-" if figure in (META, META_DECISIONS) else ""
    return f"{prefix}{algorithm}" + ("@paper" if recipe == "paper" else "")


def judge_claim(claim: Claim, results: Results) -> Finding:
    """Measure a claim with both recipes."""
    labels = {run.agent for run in results[claim.figure]}
    found: dict[str, dict[str, Estimate]] = {}
    for recipe in ("paper", "corrected"):
        names = {algorithm: name_agent(algorithm, recipe, claim.figure) for algorithm in claim.agents}
        found[recipe] = {key: claim.compute(results, name) for key, name in names.items() if name in labels}
    verdicts = {name: claim.holds.judge(estimate) for name, estimate in found["paper"].items()}
    return Finding(claim, found["paper"], found["corrected"], verdicts)


# --- kinds of measurements --------------------------------------------------------------


def _per_run(figure: str, read: Callable[[RawRun], float]) -> Callable[[Results, str], Estimate]:
    return lambda results, agent: estimate([read(run) for run in get_runs(results, figure, agent)])


def _of_runs(figure: str, ask: Callable[[RawRun], bool]) -> Callable[[Results, str], Estimate]:
    return lambda results, agent: estimate_share_of_runs([ask(run) for run in get_runs(results, figure, agent)])


def _slope(figure: str, training: bool, since: float) -> Callable[[Results, str], Estimate]:
    return lambda results, agent: estimate_slope(get_runs(results, figure, agent), training, since)


def _final(figure: str) -> Callable[[Results, str], Estimate]:
    return lambda results, agent: estimate_final(get_runs(results, figure, agent))


def _gain_by_options(results: Results, agent: str) -> Estimate:
    return estimate_gain(get_runs(results, META, agent), get_runs(results, TWO, agent.removeprefix("smdp-")))


def _above(level: float) -> Criterion:
    """The whole interval above a level, or below it."""
    return Criterion(f"above {100 * level:g}", lambda e: True if e.low > level else False if e.high <= level else None)


def _below(level: float) -> Criterion:
    return Criterion(f"below {100 * level:g}", lambda e: True if e.high < level else False if e.low >= level else None)


def _not_below(level: float) -> Criterion:
    """The interval reaches up to a level: a claim that nothing happens is refuted or not."""
    return Criterion(f"reaching {100 * level:g}", lambda e: e.high >= level)


def _late_near_best(run: RawRun) -> float:
    return share_of_training(run, run.training_near_best)


def _all_escapes(run: RawRun) -> float:
    return share_of_training(run, run.training_successes, slice(None))


CLAIMS: Sequence[Claim] = (
    Claim(
        "With one button each algorithm is able to reach the goal, with varying frequency.",
        "share of all training episodes that escape", ONE, ALL, _per_run(ONE, _all_escapes), _above(0.0), "%",
        "dqn 95 % at 6 m, 79 and 98 % at 10 m; sarsa 93 % at 6 m; ddpg 0 at 10 m",
    ),
    Claim(
        "DQN and DDPG reach viable policies almost immediately.",
        f"share of runs that escape within {EARLY:,} primitives", ONE, ("dqn", "ddpg"),
        _of_runs(ONE, lambda run: has_escaped_by(run, EARLY)), _above(0.5), "%",
        "as released, neither was ever updated (its warm-up never ended)",
    ),
    Claim(
        "DDPG never stabilises on a single good policy.",
        "share of runs with every evaluation of the last fifth optimal", ONE, ("ddpg",), _of_runs(ONE, has_settled),
        _below(0.5), "%", "ddpg 0 at 10 m",
    ),
    Claim(
        "SARSA stabilises.",
        "share of runs with every evaluation of the last fifth optimal", ONE, ("sarsa",), _of_runs(ONE, has_settled),
        _above(0.5), "%", "sarsa 70 % of the last fifth at 6 m; as released 96 % of tests at 10 m, none at 6 m",
    ),
    Claim(
        "Each agent is optimal on at least 25 % of episodes by the end.",
        "share of optimal training episodes in the last fifth", ONE, ALL, _per_run(ONE, _late_near_best),
        _above(0.25), "%", "escapes in the last fifth: dqn 95 % (6 m), 58 and 97 % (10 m); sarsa 70 %; ddpg 0",
    ),
    Claim(
        "With two buttons none of the algorithms reaches the goal.",
        "share of runs in which any training episode escapes", TWO, ALL,
        _of_runs(TWO, lambda run: run.first_escape is not None), _below(0.5), "%",
        "trained continuously, 1 of 6 runs (a dqn, 14 % of its episodes); as released dqn and ddpg did not train",
    ),
    Claim(
        "Meta-actions improve performance significantly.",
        "mean score of training episodes with meta-actions less that without", META, ALL, _gain_by_options,
        _above(0.0), "points",
        "dqn from 0 to 88 to 100 % of the last fifth's episodes; sarsa and ddpg 0 with and without",
    ),
    Claim(
        "With meta-actions two buttons are solved in a timely manner.",
        f"share of runs that escape within {EARLY:,} primitives", META, ALL,
        _of_runs(META, lambda run: has_escaped_by(run, EARLY)), _above(0.5), "%",
        "dqn 93 to 99 % of all episodes, sarsa 63 to 74 %, ddpg 0 and 17 %",
    ),
    Claim(
        "SARSA and DDPG get worse over time with meta-actions.",
        "slope of the score of training episodes, a run", META, ("sarsa", "ddpg"), _slope(META, True, 0.0),
        _below(0.0), "points", "sarsa from 63 to 74 % of all episodes to 0 in the last fifth; ddpg 0 in the last fifth",
    ),
    Claim(
        "The same, counted in 20,000 decisions as the program did.",
        "slope of the score of training episodes, a run", META_DECISIONS, ("sarsa", "ddpg"),
        _slope(META_DECISIONS, True, 0.0), _below(0.0), "points", "as above: these runs counted decisions",
    ),
    Claim(
        "DQN does not get worse with meta-actions.",
        "slope of the score of training episodes, a run", META, ("dqn",), _slope(META, True, 0.0), _not_below(0.0),
        "points", "dqn 88 to 100 % of the last fifth's episodes",
    ),
    Claim(
        "The same, counted in 20,000 decisions as the program did.",
        "slope of the score of training episodes, a run", META_DECISIONS, ("dqn",), _slope(META_DECISIONS, True, 0.0),
        _not_below(0.0), "points", "as above: these runs counted decisions",
    ),
    Claim(
        "Meta-actions alone do not ensure fitness: the model must be integrated with value fitting.",
        "final score of frozen weights", META, ALL, _final(META), _below(0.95), "%",
        "last fifth's return: dqn -5, -248, 28; sarsa and ddpg about -1,000",
    ),
)
