"""The claims of Menashe and Stone (2019), section 6, each with the measurement that tests it; `study.toml` lists them.

A claim is tested agent by agent on runs with the paper's recipe; the page compares it
with default settings, and with a rerun of the published program. Each criterion can confirm or refute, and all
claims and agents are one family of tests (Benjamini and Hochberg).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.registry import DEFAULT_RECIPE, KERAS_RL, join_name
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.inference import ALPHA, Estimate
from hrl_escape.benchmark.statistics import compute_final
from studies.paper.measures import (
    Measurement,
    Results,
    Side,
    get_runs,
    has_settled,
    measure_gain,
    measure_slope,
    share_of_training,
)
from studies.raw import RawRun
from studies.statistics import Difference, compare_signs

__all__ = ["MEASURES", "Claim", "Criterion", "Finding", "choose_level", "compare_recipes", "judge_claims"]

TWO, META = "paper-figure-2", "paper-figure-3"
CHANCE = "random-options+primitives"
EARLY = 2_000
"""Primitives; a tenth of a run."""


def _count(ask: Callable[[RawRun], bool]) -> Callable[[Results, str, str], Measurement]:
    return lambda results, figure, agent: Measurement(tuple(
        float(ask(run)) for run in get_runs(results, figure, agent)))


def _leave_options(agent: str) -> str:
    """Spec of the same agent over primitives."""
    spec = AgentSpec.parse(agent)
    return str(AgentSpec(spec.algorithm, recipe=spec.recipe))


MEASURES: Mapping[str, Callable[[Results, str, str], Measurement]] = {
    "escapes": _count(lambda run: run.first_escape is not None),
    "escapes-early": _count(lambda run: run.first_escape is not None and run.first_escape <= EARLY),
    "settles": _count(has_settled),
    "often-optimal": _count(lambda run: share_of_training(run, run.training_optimal) >= 0.25),
    "slope": lambda results, figure, agent: measure_slope(get_runs(results, figure, agent), True, 0.0),
    "gain-by-options": lambda results, figure, agent: measure_gain(
        get_runs(results, figure, agent), get_runs(results, TWO, _leave_options(agent))),
    "gain-over-chance": lambda results, figure, agent: measure_gain(
        get_runs(results, figure, agent), get_runs(results, figure, CHANCE)),
    "final-over-chance": lambda results, figure, agent: measure_gain(
        get_runs(results, figure, agent), get_runs(results, figure, CHANCE),
        lambda run: compute_final(run.at, run.scores, run.budget)),
}
"""Name -> measurement from (results, grid, agent's label)."""


OF_CHANCE = ("escapes", "escapes-early")
"""Measures that ask for no learning, so that random choices can settle a claim."""


@dataclass(frozen=True)
class Criterion:
    """Condition for a measurement to confirm or refute a claim.

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
        """Side where the claim does not hold."""
        return "below" if self.side == "above" else "above"

    def test(self, found: Measurement) -> tuple[bool, float]:
        """Direction of the runs, True for the claim, and its p-value.

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
        measure: name in `MEASURES`.
        holds: condition for an estimate to confirm the claim.
        unit: `%`, or `points` for differences and slopes of a score in per cent.
        rerun: results of the published program when rerun.
    """

    says: str
    measured: str
    figure: str
    agents: tuple[str, ...]
    measure: str
    holds: Criterion
    unit: str
    rerun: str


@dataclass(frozen=True)
class Finding:
    """Verdicts on a claim.

    Attributes:
        claim: the claim.
        paper: algorithm -> estimate with the paper's recipe.
        corrected: algorithm -> estimate with the default settings; empty where it was not run.
        verdicts: algorithm -> True if the paper's recipe confirms the claim, False if it refutes it, None if open.
        p: algorithm -> p-value of the verdict, corrected over all claims and algorithms.
        by_chance: True where random choices confirm the claim by the same test (p < 0.05, alone), False where they
            refute it; either way it says nothing of learning. None elsewhere.
    """

    claim: Claim
    paper: dict[str, Estimate]
    corrected: dict[str, Estimate]
    verdicts: dict[str, bool | None]
    p: dict[str, float]
    by_chance: bool | None = None

    @property
    def kind(self) -> Literal["yes", "no", "some", "none", "open"]:
        """`yes` or `no` where all algorithms agree; `some` if it holds for some only, `none` if for none; or `open`."""
        verdicts = set(self.verdicts.values())
        if verdicts == {True}:
            return "yes"
        if True in verdicts:
            return "some"
        if False in verdicts:
            return "no" if verdicts == {False} else "none"
        return "open"


def name_agent(algorithm: str, recipe: str, figure: str) -> str:
    """An agent's label in a figure's grid."""
    over_options = figure.startswith(META)
    return str(AgentSpec(join_name(algorithm, over_options), recipe=recipe,
                         options=OptionsView(include_primitives=over_options)))


def judge_claims(claims: Sequence[Claim], results: Results) -> list[Finding]:
    """Measure claims with both recipes and judge them as one family.

    Intervals are of the level at which 5 % of those behind verdicts miss at most on average (Benjamini and Yekutieli
    2005). A verdict whose test is two-sided is given just where that interval leaves its level out.
    """
    measured = [(_measure(claim, results, KERAS_RL), _measure(claim, results, DEFAULT_RECIPE)) for claim in claims]
    tests = [(number, name, *claim.holds.test(found)) for number, (claim, (paper, _))
             in enumerate(zip(claims, measured, strict=True)) for name, found in paper.items()]
    adjusted = stats.false_discovery_control([p for *_, p in tests]).tolist()
    level = choose_level(adjusted)
    findings = [Finding(claim, _estimate(paper, level), _estimate(corrected, level), {}, {},
                        _judge_chance(claim, results))
                for claim, (paper, corrected) in zip(claims, measured, strict=True)]
    for (number, name, holds, _), p in zip(tests, adjusted, strict=True):
        findings[number].verdicts[name] = holds if p < ALPHA else None
        findings[number].p[name] = p
    return findings


def choose_level(adjusted: Sequence[float]) -> float:
    """Level of the intervals of corrected p-values: 1 less the share of 5 % that is rejected, one at least."""
    return 1 - ALPHA * max(1, sum(p < ALPHA for p in adjusted)) / len(adjusted)


def _measure(claim: Claim, results: Results, recipe: str) -> dict[str, Measurement]:
    labels = {run.agent for run in results[claim.figure]}
    names = {algorithm: name_agent(algorithm, recipe, claim.figure) for algorithm in claim.agents}
    return {key: MEASURES[claim.measure](results, claim.figure, name) for key, name in names.items() if name in labels}


def compare_recipes(results: Results) -> dict[str, Difference]:
    """Compare the training scores with options, defaults less the settings of 2019, by pairs of seeds (Holm)."""
    pairs = {name: [name_agent(name, recipe, META) for recipe in (DEFAULT_RECIPE, KERAS_RL)]
             for name in ("dqn", "sarsa", "ddpg")}
    return compare_signs({name: measure_gain(get_runs(results, META, default), get_runs(results, META, paper)).values
                          for name, (default, paper) in pairs.items()})


def _judge_chance(claim: Claim, results: Results) -> bool | None:
    """True if random choices confirm the claim, False if they refute it; None if neither."""
    if claim.measure not in OF_CHANCE:
        return None
    found = MEASURES[claim.measure](results, claim.figure, name_agent("random", DEFAULT_RECIPE, claim.figure))
    holds, p = claim.holds.test(found)
    return holds if p < ALPHA else None


def _estimate(found: dict[str, Measurement], level: float) -> dict[str, Estimate]:
    return {name: measurement.estimate(level) for name, measurement in found.items()}
