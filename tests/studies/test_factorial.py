"""The study of what makes SARSA worsen: its agents, its effects, and rules with data of other truths."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from hrl_escape.errors import ComparisonError
from studies.__main__ import main
from studies.factorial.analysis import analyse
from studies.factorial.design import (
    ALGORITHMS,
    FACTORS,
    get_factors,
    make_factorial_grid,
    make_label,
    make_screening_design,
    name_factorial,
)
from studies.factorial.effects import (
    Screening,
    compute_effects,
    measure_area,
    measure_change,
    repeat_effects,
)
from studies.pages.paper import RULES
from studies.raw import BINS, RawRun
from studies.statistics import choose_holm_levels
from studies.study import find_study
from tests.studies.made_up_runs import make_run

RISE = np.linspace(0.5, 1.5, BINS)
"""Efficiency along a run, over its mean; it changes by 20/19 of the mean."""
Levels = Mapping[str, bool]
"""Factor -> it is corrected."""


def make_runs(truth: Callable[[Levels], float], *, algorithm: str = "sarsa", rooms: int = 4, seeds: int = 5,
              first_seed: int = 0, noise: float = 0.02,
              repeat: Callable[[Levels], float] = lambda _: 2.0) -> list[RawRun]:
    """Runs whose efficiency rises from half the truth to one and a half, with noise; so level and slope are the truth.

    The longest repeat is 2 to the power that `repeat` says; its own noise moves efficiency by -0.1 a doubling.
    """
    source, names, runs = np.random.default_rng(3), get_factors(algorithm), []
    for room in range(rooms):
        for seed in range(first_seed, first_seed + seeds):
            for levels in make_screening_design(len(names)).tolist():
                corrected = {name: level > 0 for name, level in zip(names, levels, strict=True)}
                doubling = source.normal(0, 0.3)
                value = truth(corrected) - 0.1 * doubling + source.normal(0, noise)
                runs.append(make_run(make_label(algorithm, levels), [value] * 11, training=value * RISE, seed=seed,
                                     room=f"room {room}",
                                     grid=name_factorial(algorithm, first_seed > 0),
                                     longest_repeat=(2 ** (repeat(corrected) + doubling),) * BINS))
    return runs


# --- agents ----------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_agents_differ_in_the_factors_their_labels_say_and_in_nothing_else(algorithm: str):
    grid = make_factorial_grid(algorithm)
    published, corrected = grid.agents[0], grid.agents[-1]
    assert len(grid.agents) == 24
    assert published.options.include_primitives and not corrected.options.include_primitives
    recommended = dataclasses.replace(corrected, settings={}).resolve_settings()
    differing = {name for name, value in corrected.resolve_settings().items() if value != recommended[name]}
    assert differing == {"epsilon_steps"}
    recipe = dataclasses.replace(published, settings={}, recipe="keras-rl-2019").resolve_settings()
    kept = {"clock", "late_terminal", "warmup", "actor_warmup", "updates_per_step", "epsilon_steps"}
    differing = {name for name, value in published.resolve_settings().items() if value != recipe[name]}
    assert differing <= kept, differing - kept
    for agent in grid.agents:
        settings, levels = agent.resolve_settings(), agent.label.rpartition("-")[2]
        for factor, level in zip(FACTORS[algorithm], levels, strict=True):
            chosen = factor.high if level == "1" else factor.low
            assert {name: settings[name] for name in chosen} == {
                name: list(value) if isinstance(value, tuple) else value for name, value in chosen.items()}
            if factor.options_only:
                assert agent.options.include_primitives == (level == "0")


def test_rooms_are_drawn_from_one_room_configuration_and_relabelled():
    rooms = make_factorial_grid("sarsa", rooms=8).make_places()
    assert len({room.name for room in rooms}) == 8
    assert len({room.instance.puzzle.edges for room in rooms}) > 2, "numbers say nothing of the order"
    fresh = make_factorial_grid("sarsa", rooms=2, first=100)
    assert not {room.id for room in fresh.make_places()} & {room.id for room in rooms}
    assert (fresh.name, fresh.first_seed) == ("factorial-sarsa-fresh", 100), "raw results of their own"


# --- effects ---------------------------------------------------------------------------


def test_effects_are_those_of_least_squares_and_their_test_students_over_rooms():
    runs = make_runs(lambda on: 0.3 + 0.2 * on["buffer"], noise=0.1)
    screening = Screening.make("sarsa", runs)
    effects = compute_effects(screening, measure_area)
    levels = screening.design / 2
    expected = []
    for room in screening.rooms:
        values = np.mean([[measure_area(run) for run in screening.runs[room, seed]] for seed in screening.seeds], 0)
        solution, *_ = np.linalg.lstsq(np.column_stack([np.ones(24), levels]), values, rcond=None)
        expected.append(solution[1:])
    assert np.array([effect.rooms for effect in effects]).T == pytest.approx(np.array(expected))
    references = [stats.ttest_1samp(column, 0) for column in np.array(expected).T]
    levels = choose_holm_levels([reference.pvalue for reference in references])
    for effect, reference, level in zip(effects, references, levels, strict=True):
        assert effect.test.p == pytest.approx(reference.pvalue)
        assert (effect.test.low, effect.test.high) == pytest.approx(tuple(reference.confidence_interval(level)))
    assert {effect.factor for effect in effects if effect.is_shown} == {"buffer"}


def test_responses_are_the_mean_height_and_the_whole_change_of_a_curve_with_gaps():
    falling = make_run("a", [0.5], training=np.linspace(1, 0, BINS).tolist())
    gaps = dataclasses.replace(falling, training_efficiencies=tuple(
        value if n % 3 else None for n, value in enumerate(falling.training_efficiencies)))
    for run in (falling, gaps):
        assert measure_area(run) == pytest.approx(0.5, abs=0.02)
        assert measure_change(run) == pytest.approx(-20 / 19)
    assert measure_area(dataclasses.replace(falling, training_efficiencies=(None,) * BINS)) == 0


def test_a_missing_run_is_refused():
    with pytest.raises(ComparisonError, match="all runs finished"):
        Screening.make("sarsa", make_runs(lambda on: 0.5)[1:])


TRUTHS: dict[str, tuple[Callable[[Levels], float], set[str], set[str]]] = {
    "exploration causes it": (lambda on: 0.1 + 0.5 * on["exploration"], {"exploration"}, set()),
    "replay causes it": (lambda on: 0.1 + 0.5 * on["buffer"], {"buffer"}, set()),
    "a default harms": (lambda on: 0.6 - 0.3 * on["loss"], set(), {"loss"}),
    "nothing matters": (lambda on: 0.5, set(), set()),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_each_truth_is_found(name: str):
    truth, raising, lowering = TRUTHS[name]
    effects = compute_effects(Screening.make("sarsa", make_runs(truth)), measure_change)
    shown = {effect.factor: effect.test.difference for effect in effects if effect.is_shown}
    assert {factor for factor, change in shown.items() if change > 0} == raising
    assert {factor for factor, change in shown.items() if change < 0} == lowering


def test_intervals_leave_0_out_just_where_an_effect_is_shown():
    for height in (0.03, 0.3):
        runs = make_runs(lambda on, height=height: 0.3 + height * on["choices"], rooms=3, noise=0.05)
        for measure in (measure_change, measure_area):
            for effect in compute_effects(Screening.make("sarsa", runs), measure):
                assert (effect.test.low > 0 or effect.test.high < 0) == effect.is_shown


def test_slope_and_level_are_measured_apart():
    def turn(run: RawRun, corrected: bool) -> RawRun:
        """Level 0.4 in every run; only a replay buffer keeps it from falling."""
        rise = (0.1 if corrected else -0.3) * (1 + 0.02 * int(run.room[-1]))
        course = tuple(0.4 + rise * (place - 0.5) for place in np.linspace(0, 1, BINS))
        return dataclasses.replace(run, training_efficiencies=course)

    runs = [turn(run, run.agent.rpartition("-")[2][get_factors("sarsa").index("buffer")] == "1")
            for run in make_runs(lambda on: 0.4)]
    screening = Screening.make("sarsa", runs)
    slope, level = (compute_effects(screening, measure) for measure in (measure_change, measure_area))
    assert {effect.factor for effect in slope if effect.is_shown} == {"buffer"}
    assert not any(effect.is_shown for effect in level)


@pytest.mark.parametrize(("fresh", "sign"), [
    (lambda on: 0.2 + 0.3 * on["buffer"], 1), (lambda on: 0.6 - 0.3 * on["buffer"], -1),
    (lambda on: 0.3 + 0.3 * on["loss"], 0),
])
def test_fresh_runs_test_what_was_shown_and_nothing_else(fresh: Callable[[Levels], float], sign: int):
    again = Screening.make("sarsa", make_runs(fresh, rooms=3, seeds=1, first_seed=100))
    (found,) = repeat_effects(again, ["buffer"])
    assert (np.sign(found.test.difference) if found.is_shown else 0) == sign
    assert (found.test.low > 0 or found.test.high < 0) == bool(sign)
    two = repeat_effects(again, ["buffer", "width"])
    assert two[0].p >= found.p, "two effects share a correction"


# --- findings and command --------------------------------------------------------------


def find(truth: Callable[[Levels], float], fresh: Callable[[Levels], float]) -> SimpleNamespace:
    lines = [run for name in ALGORITHMS for run in make_runs(
        truth if name == "sarsa" else lambda on: 0.5, algorithm=name, rooms=5 if name == "sarsa" else 3)]
    lines += make_runs(fresh, rooms=3, seeds=2, first_seed=100)
    return SimpleNamespace(factorial=analyse(find_study("factorial"), lines).numbers)


def test_rules_follow_the_effects():
    def causes(on: Levels) -> float:
        return 0.1 + 0.2 * on["buffer"] + 0.2 * on["choices"] + 0.2 * on["scaling"]

    found = find(causes, causes)
    assert RULES["causes"](found) and RULES["ddpg-is-open"](found)
    assert found.factorial.rooms == {"sarsa": 5, "ddpg": 3} and len(found.factorial.first_p) == 3
    assert not RULES["causes"](find(causes, lambda on: 0.5)), "not again in fresh rooms"
    assert not RULES["causes"](find(lambda on: causes(on) + 0.2 * on["discount"], causes)), "a fourth cause"


def test_the_course_is_that_of_the_first_and_the_last_agent():
    found = find(lambda on: 0.2 + 0.3 * all(on.values()), lambda on: 0.5).factorial.course
    assert found["efficiency", "2019"][0] == pytest.approx(0.2 * 0.6, abs=0.03)
    assert found["efficiency", "default"][-1] == pytest.approx(0.5 * 1.4, abs=0.05)
    assert found["longest repeat, decisions", "2019"][0] == pytest.approx(4, abs=0.5)


def test_a_factorial_wants_an_algorithm(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["factorial", "--docs", str(tmp_path), "--algorithms"]) == 2
    assert "name one or more of sarsa, ddpg" in capsys.readouterr().err
