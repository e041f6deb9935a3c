"""The claims of Menashe and Stone (2019), section 6, each with the measurement that tests it.

A claim is tested agent by agent on runs with the paper's recipe; beside it stand the same measurement with the
corrected recipe, and what the published program gave when it was rerun. Each criterion can come out either way, and all
claims and agents are one family of tests (Benjamini and Hochberg).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hrl_escape.comparison.inference import Estimate, correct_by_benjamini_hochberg
from hrl_escape.comparison.pairs import ALPHA
from hrl_escape.comparison.statistics import compute_final
from hrl_escape.comparison.studies.measures import (
    Measurement,
    Results,
    Side,
    get_runs,
    has_escaped_by,
    has_settled,
    measure_gain,
    measure_share_of_runs,
    measure_slope,
    share_of_training,
)
from hrl_escape.comparison.studies.raw import RawRun

__all__ = ["CLAIMS", "Claim", "Criterion", "Finding", "FIGURES", "judge_claims", "name_agent"]

FIGURES = ("paper-figure-1", "paper-figure-2", "paper-figure-3", "paper-figure-3-decisions")
ONE, TWO, META, META_DECISIONS = FIGURES
ALL = ("dqn", "sarsa", "ddpg")
CHANCE = "smdp-random"
EARLY = 2_000
"""Primitives; a tenth of a run."""
RARE, OFTEN = 0.05, 1 / 3
"""A share of runs below `OFTEN` confirms that something does not happen, one above `RARE` refutes it: ten runs can show
either. The same the other way round for what does happen."""
STEADY = -0.1
"""Slope a run from which on a score does not get worse."""


@dataclass(frozen=True)
class Criterion:
    """Condition under which a measurement confirms or refutes a claim.

    Attributes:
        side: where the claim holds.
        level: level beyond which, on that side, the claim holds.
        refuted: level beyond which, on the other side, it does not; as `level` by default.
    """

    side: Side
    level: float
    refuted: float | None = None

    @property
    def words(self) -> str:
        """`above 50`, or both levels where they differ."""
        if self.refuted is None:
            return f"{self.side} {100 * self.level:.0f}"
        return f"{self.side} {100 * self.level:.0f} confirms, {self.other_side} {100 * self.refuted:.0f} refutes"

    @property
    def other_side(self) -> Side:
        """Side on which the claim does not hold."""
        return "below" if self.side == "above" else "above"

    def test(self, found: Measurement) -> tuple[bool, float]:
        """Direction in which the runs point, True for the claim, and its p-value.

        Where one level parts both directions, a truth right there could be missed on either side, so the p-value is
        two-sided. Between two levels neither direction is wrong, and it is one-sided.
        """
        confirmed = found.compute_p(self.level, self.side)
        refuted = found.compute_p(self.level if self.refuted is None else self.refuted, self.other_side)
        return confirmed < refuted, min(1.0, (2 if self.refuted is None else 1) * min(confirmed, refuted))


@dataclass(frozen=True)
class Claim:
    """Claim of the paper.

    Attributes:
        says: the paper's words, shortened.
        measured: the measurement, in words.
        figure: grid of the measurement.
        agents: algorithms that the claim is about.
        compute: the measurement, from (results, agent's label).
        holds: condition under which an estimate confirms the claim.
        unit: `%`, or `points` for differences and slopes of a score in per cent.
        rerun: results of the published program when rerun.
    """

    says: str
    measured: str
    figure: str
    agents: tuple[str, ...]
    compute: Callable[[Results, str], Measurement]
    holds: Criterion
    unit: str
    rerun: str


@dataclass(frozen=True)
class Finding:
    """Outcome of a claim.

    Attributes:
        claim: the claim.
        paper: algorithm -> estimate with the paper's recipe.
        corrected: algorithm -> estimate with the corrected recipe; empty where it was not run.
        verdicts: algorithm -> True if the paper's recipe confirms the claim, False if it refutes it, None if open.
        p: algorithm -> p-value of the verdict, corrected over all claims and algorithms.
    """

    claim: Claim
    paper: dict[str, Estimate]
    corrected: dict[str, Estimate]
    verdicts: dict[str, bool | None]
    p: dict[str, float]

    @property
    def agrees(self) -> str:
        """`yes`, `no` or `open`; where algorithms differ, each answer with its algorithms."""
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


def judge_claims(claims: Sequence[Claim], results: Results) -> list[Finding]:
    """Measure claims with both recipes and judge them as one family."""
    measured = [(_measure(claim, results, "paper"), _measure(claim, results, "corrected")) for claim in claims]
    tests = [(number, name, *claim.holds.test(found)) for number, (claim, (paper, _))
             in enumerate(zip(claims, measured, strict=True)) for name, found in paper.items()]
    adjusted = correct_by_benjamini_hochberg([p for *_, p in tests])
    findings = [Finding(claim, _estimate(paper), _estimate(corrected), {}, {})
                for claim, (paper, corrected) in zip(claims, measured, strict=True)]
    for (number, name, holds, _), p in zip(tests, adjusted, strict=True):
        findings[number].verdicts[name] = holds if p < ALPHA else None
        findings[number].p[name] = p
    return findings


def _measure(claim: Claim, results: Results, recipe: str) -> dict[str, Measurement]:
    labels = {run.agent for run in results[claim.figure]}
    names = {algorithm: name_agent(algorithm, recipe, claim.figure) for algorithm in claim.agents}
    return {key: claim.compute(results, name) for key, name in names.items() if name in labels}


def _estimate(found: dict[str, Measurement]) -> dict[str, Estimate]:
    return {name: measurement.estimate() for name, measurement in found.items()}


# --- kinds of measurements --------------------------------------------------------------


def _of_runs(figure: str, ask: Callable[[RawRun], bool]) -> Callable[[Results, str], Measurement]:
    return lambda results, agent: measure_share_of_runs([ask(run) for run in get_runs(results, figure, agent)])


def _slope(figure: str) -> Callable[[Results, str], Measurement]:
    return lambda results, agent: measure_slope(get_runs(results, figure, agent), True, 0.0)


def _gain_by_options(results: Results, agent: str) -> Measurement:
    return measure_gain(get_runs(results, META, agent), get_runs(results, TWO, agent.removeprefix("smdp-")))


def _gain_over_chance(results: Results, agent: str) -> Measurement:
    return measure_gain(get_runs(results, META, agent), get_runs(results, META, CHANCE))


def _final_over_chance(results: Results, agent: str) -> Measurement:
    return measure_gain(get_runs(results, META, agent), get_runs(results, META, CHANCE),
                        lambda run: compute_final(run.at, run.scores, run.budget))


CLAIMS: Sequence[Claim] = (
    Claim(
        "With one button each algorithm is able to reach the goal, with varying frequency.",
        "share of runs in which any training episode escapes", ONE, ALL,
        _of_runs(ONE, lambda run: run.first_escape is not None), Criterion("above", RARE, OFTEN), "%",
        "dqn 95 % at 6 m, 79 and 98 % at 10 m; sarsa 93 % at 6 m; ddpg 0 at 10 m",
    ),
    Claim(
        "DQN and DDPG reach viable policies almost immediately.",
        f"share of runs that escape within {EARLY:,} primitives", ONE, ("dqn", "ddpg"),
        _of_runs(ONE, lambda run: has_escaped_by(run, EARLY)), Criterion("above", 0.5), "%",
        "as released, neither was ever updated (its warm-up never ended)",
    ),
    Claim(
        "DDPG never stabilises on a single good policy.",
        "share of runs with every evaluation of the last fifth optimal", ONE, ("ddpg",), _of_runs(ONE, has_settled),
        Criterion("below", 0.5), "%", "ddpg 0 at 10 m",
    ),
    Claim(
        "SARSA stabilises.",
        "share of runs with every evaluation of the last fifth optimal", ONE, ("sarsa",), _of_runs(ONE, has_settled),
        Criterion("above", 0.5), "%",
        "sarsa 70 % of the last fifth at 6 m; as released 96 % of tests at 10 m, none at 6 m",
    ),
    Claim(
        "Each agent is optimal on at least 25 % of episodes by the end.",
        "share of runs with 25 % optimal training episodes in the last fifth", ONE, ALL,
        _of_runs(ONE, lambda run: share_of_training(run, run.training_optimal) >= 0.25), Criterion("above", 0.5), "%",
        "escapes in the last fifth: dqn 95 % (6 m), 58 and 97 % (10 m); sarsa 70 %; ddpg 0",
    ),
    Claim(
        "With two buttons none of the algorithms reaches the goal.",
        "share of runs in which any training episode escapes", TWO, ALL,
        _of_runs(TWO, lambda run: run.first_escape is not None), Criterion("below", OFTEN, RARE), "%",
        "trained continuously, 1 of 6 runs (a dqn, 14 % of its episodes); as released dqn and ddpg did not train",
    ),
    Claim(
        "Meta-actions improve performance significantly.",
        "mean score of training episodes with meta-actions less that without", META, ALL, _gain_by_options,
        Criterion("above", 0.0), "points",
        "dqn from 0 to 88 to 100 % of the last fifth's episodes; sarsa and ddpg 0 with and without",
    ),
    Claim(
        "The same, beyond what choosing among the meta-actions at random gives.",
        "mean score of training episodes less that of `smdp-random`", META, ALL, _gain_over_chance,
        Criterion("above", 0.0), "points", "not measured: the program has no random policy",
    ),
    Claim(
        "With meta-actions two buttons are solved in a timely manner.",
        f"share of runs that escape within {EARLY:,} primitives", META, ALL,
        _of_runs(META, lambda run: has_escaped_by(run, EARLY)), Criterion("above", 0.5), "%",
        "dqn 93 to 99 % of all episodes, sarsa 63 to 74 %, ddpg 0 and 17 %",
    ),
    Claim(
        "SARSA and DDPG get worse over time with meta-actions.",
        "slope of the score of training episodes, a run", META, ("sarsa", "ddpg"), _slope(META),
        Criterion("below", 0.0), "points",
        "sarsa from 63 to 74 % of all episodes to 0 in the last fifth; ddpg 0 in the last fifth",
    ),
    Claim(
        "The same, counted in 20,000 decisions as the program did.",
        "slope of the score of training episodes, a run", META_DECISIONS, ("sarsa", "ddpg"),
        _slope(META_DECISIONS), Criterion("below", 0.0), "points", "as above: these runs counted decisions",
    ),
    Claim(
        "DQN does not get worse with meta-actions.",
        "slope of the score of training episodes, a run", META, ("dqn",), _slope(META), Criterion("above", STEADY),
        "points", "dqn 88 to 100 % of the last fifth's episodes",
    ),
    Claim(
        "The same, counted in 20,000 decisions as the program did.",
        "slope of the score of training episodes, a run", META_DECISIONS, ("dqn",), _slope(META_DECISIONS),
        Criterion("above", STEADY), "points", "as above: these runs counted decisions",
    ),
    Claim(
        "Meta-actions alone do not ensure fitness: the model must be integrated with value fitting.",
        "final score of frozen weights less that of choosing among the meta-actions at random", META, ALL,
        _final_over_chance, Criterion("below", 0.0), "points",
        "last fifth's return: dqn -5, -248, 28; sarsa and ddpg about -1,000",
    ),
)
