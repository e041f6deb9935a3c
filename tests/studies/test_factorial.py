"""The study of what makes SARSA worsen: its agents, effects and paths, and conclusions that follow the truth."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from hrl_escape.errors import ComparisonError
from studies.__main__ import main
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
    find_sufficient,
    measure_area,
    measure_change,
)
from studies.factorial.mediation import compute_paths
from studies.factorial.words import advise, analyse_screening, conclude, tell_first_look, tell_fresh_runs
from studies.raw import BINS, RawRun
from studies.statistics import choose_holm_levels
from tests.studies.made_up_runs import make_run
from tests.studies.pages import save, tell

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


@pytest.mark.parametrize(("truth", "verdicts"), [
    (lambda on: 0.1 + 0.6 * (on["exploration"] or on["buffer"]), {True}),
    (lambda on: 0.1 + 0.6 * (on["exploration"] or on["buffer"] or on["choices"]), {True}),
    (lambda on: 0.1 + 0.3 * on["exploration"] + 0.3 * on["buffer"] + 0.1 * on["loss"], {False}),
    (lambda on: 0.1 + 0.6 * (on["exploration"] and on["buffer"]), {False}),
])
def test_alone_suffices_what_brings_most_of_what_all_bring(truth: Callable[[Levels], float], verdicts: set[bool]):
    screening = Screening.make("sarsa", make_runs(truth))
    found = find_sufficient(screening, compute_effects(screening, measure_area), measure_area)
    assert len(found) >= 2 and set(found.values()) == verdicts


# --- paths -----------------------------------------------------------------------------


def test_a_path_is_the_product_of_the_coefficients_of_least_squares():
    runs = make_runs(lambda on: 0.3 - 0.1 * (4 - 2 * on["exploration"]),
                     repeat=lambda on: 4.0 - 2 * on["exploration"])
    screening = Screening.make("sarsa", runs)
    found = compute_paths(screening, ["exploration", "loss"], measure_area, np.random.default_rng(0), 500)
    paths = {(path.factor, path.mediator): path for path in found}
    design = np.tile(screening.design / 2, (20, 1))
    blocks = np.repeat(np.eye(20), 24, axis=0)
    repeats = np.log2([run.longest_repeat[0] or 1 for run in runs])
    areas = [measure_area(run) for run in runs]
    moves = np.linalg.lstsq(np.column_stack([design, blocks]), repeats, rcond=None)[0]
    within = np.kron(np.eye(20), screening.design)  # effects of their own in each block
    slopes = np.linalg.lstsq(np.column_stack([repeats, within, blocks]), areas, rcond=None)[0]
    path = paths["exploration", "longest repeat"]
    number = get_factors("sarsa").index("exploration")
    assert (path.moves, path.slope) == pytest.approx((moves[number], slopes[0]))
    assert path.carries == pytest.approx(path.moves * path.slope) == pytest.approx(0.2, abs=0.03)
    assert path.low < path.carries < path.high and path.is_shown
    assert not paths["loss", "longest repeat"].is_shown, "a factor that moves no repeat"
    assert not paths["exploration", "greedy choices"].is_shown, "a quantity that does not vary"


def test_an_effect_that_passes_by_the_logs_has_no_path():
    screening = Screening.make("sarsa", make_runs(lambda on: 0.3 + 0.4 * on["exploration"]))
    assert not any(path.is_shown for path in compute_paths(screening, ["exploration"], measure_area,
                                                           np.random.default_rng(0), 500))


# --- conclusions -----------------------------------------------------------------------

TRUTHS: dict[str, tuple[Callable[[Levels], float], list[str]]] = {
    "exploration causes it": (lambda on: 0.1 + 0.5 * on["exploration"],
                              ["One correction is shown to raise the slope: exploration (+0."]),
    "replay causes it": (lambda on: 0.1 + 0.5 * on["buffer"],
                         ["One correction is shown to raise the slope: buffer (+0."]),
    "several suffice": (lambda on: 0.1 + 0.6 * (on["exploration"] or on["buffer"]),
                        ["The slope is raised by ", " alone brings more than three quarters of what",
                         "these runs name no single cause"]),
    "both are needed": (lambda on: 0.1 + 0.6 * (on["exploration"] and on["buffer"]),
                        ["The slope is raised by", "Neither ",
                         " on its own brings three quarters of what they bring together."]),
    "a correction harms": (lambda on: 0.6 - 0.3 * on["loss"],
                           ["No correction is shown to raise the slope.", "The slope is lowered by loss (-0."]),
    "nothing matters": (lambda on: 0.5, ["No correction is shown to raise the slope."]),
}


@pytest.mark.nightly
def test_different_truths_get_different_conclusions():
    said = {name: " ".join(conclude(analyse_screening(Screening.make("sarsa", make_runs(truth)))))
            for name, (truth, _) in TRUTHS.items()}
    assert len(set(said.values())) == len(TRUTHS)
    for name, (_, expected) in TRUTHS.items():
        for words in expected:
            assert words in said[name], (name, said[name])
    assert "single cause" not in said["exploration causes it"] + said["both are needed"]
    assert "On the slope nothing is shown of discount, truncation" in said["replay causes it"]
    assert "No quantity of the logs is shown to carry the effect of buffer." in said["replay causes it"]


@pytest.mark.nightly
def test_intervals_leave_0_out_just_where_an_effect_is_shown_and_power_is_told():
    runs = make_runs(lambda on: 0.3 + 0.03 * on["choices"], rooms=3, noise=0.05)
    findings = analyse_screening(Screening.make("sarsa", runs))
    said = " ".join(conclude(findings))
    assert said.startswith("No correction is shown to raise the slope. No correction is shown to raise the level.")
    assert "a study of this size has 80 % power to detect an effect of 0." in said
    strong = analyse_screening(Screening.make("sarsa", make_runs(lambda on: 0.3 + 0.3 * on["choices"])))
    for effect in (*findings.effects, *findings.levels, *strong.effects, *strong.levels):
        assert (effect.test.low > 0 or effect.test.high < 0) == effect.is_shown
    assert strong.effects[0].visible < findings.effects[0].visible, "more rooms see more"


def test_the_slope_decides_and_the_level_stands_beside_it():
    def turn(run: RawRun, corrected: bool) -> RawRun:
        """Level 0.4 in every run; only a replay buffer keeps it from falling."""
        rise = (0.1 if corrected else -0.3) * (1 + 0.02 * int(run.room[-1]))
        course = tuple(0.4 + rise * (place - 0.5) for place in np.linspace(0, 1, BINS))
        return dataclasses.replace(run, training_efficiencies=course)

    runs = [turn(run, run.agent.rpartition("-")[2][get_factors("sarsa").index("buffer")] == "1")
            for run in make_runs(lambda on: 0.4)]
    said = conclude(analyse_screening(Screening.make("sarsa", runs)))
    assert said[0].startswith("One correction is shown to raise the slope: buffer (+0.4")
    assert said[1] == "No correction is shown to raise the level."


@pytest.mark.parametrize(("truth", "words"), [
    (lambda on: 0.3 + 0.3 * on["choices"], "take these parts of the default settings: choices (options only)."),
    (lambda on: 0.5, "Take the default settings as a whole: no part of them is shown to help alone."),
    (lambda on: 0.6 - 0.3 * on["scaling"], "to help alone; leave scaling (both scaled) as published."),
])
def test_advice_follows_the_effects(truth: Callable[[Levels], float], words: str):
    findings = analyse_screening(Screening.make("sarsa", make_runs(truth)))
    assert advise(findings, FACTORS["sarsa"]).endswith(words), advise(findings, FACTORS["sarsa"])
    few = analyse_screening(Screening.make("sarsa", make_runs(truth, rooms=2)))
    assert advise(few, FACTORS["sarsa"]).startswith("Run more rooms and seeds")


def test_a_mechanism_is_told_where_the_logs_hold_it():
    runs = make_runs(lambda on: 0.3 + 0.2 * on["exploration"], repeat=lambda on: 4.0 - 2 * on["exploration"])
    assert "The effect of exploration goes, as far as the logs show, through longest repeat (+0." in " ".join(
        conclude(analyse_screening(Screening.make("sarsa", runs))))


@pytest.mark.parametrize(("rooms", "seeds"), [(4, 4), (2, 5)])
def test_nothing_is_concluded_from_few_seeds_or_rooms(rooms: int, seeds: int):
    runs = make_runs(lambda on: 0.1 + 0.5 * on["exploration"], rooms=rooms, seeds=seeds)
    said = conclude(analyse_screening(Screening.make("sarsa", runs)))
    assert len(said) == 1 and "nothing is concluded" in said[0]


@pytest.mark.parametrize(("published", "fresh", "words"), [
    (lambda on: 0.1 + 0.5 * on["buffer"], lambda on: 0.2 + 0.3 * on["buffer"], "Buffer (+0.3"),
    (lambda on: 0.1 + 0.5 * on["buffer"], lambda on: 0.2 + 0.3 * on["buffer"], "the same conclusion (p < 0.001)"),
    (lambda on: 0.1 + 0.5 * on["buffer"], lambda on: 0.6 - 0.3 * on["buffer"], "the contrary (p < 0.001)"),
    (lambda on: 0.1 + 0.5 * on["buffer"], lambda on: 0.3 + 0.3 * on["loss"], "not shown again (p = "),
    (lambda on: 0.5, lambda on: 0.5, "The same conclusion: no effect is shown."),
    (lambda on: 0.5, lambda on: 0.3 + 0.3 * on["loss"], "Another conclusion: loss (+0.3"),
])
def test_fresh_runs_agree_or_not(published: Callable[[Levels], float], fresh: Callable[[Levels], float], words: str):
    again = Screening.make("sarsa", make_runs(fresh, rooms=3, seeds=1, first_seed=100))
    said = tell_fresh_runs(again, analyse_screening(Screening.make("sarsa", make_runs(published))))
    assert words in said and len(said) < 120, "only what was shown is tested"
    if "(p " in said:
        low, high = map(float, re.findall(r"([+-][\d.]+) to ([+-][\d.]+)", said)[0])
        assert (low > 0 or high < 0) == ("not shown again" not in said), "interval and verdict agree"


@pytest.mark.parametrize(("truth", "rooms", "words"), [
    (lambda on: 0.1 + 0.5 * on["buffer"], 5, "looked at, in which buffer had p <"),
    (lambda on: 0.3 + 0.03 * on["choices"], 5, "in which choices had p = 0."),
    (lambda on: 0.5, 5, "had p = 0."),
    (lambda on: 0.1 + 0.5 * on["buffer"], 3, ""),
])
def test_rooms_that_were_added_after_a_look_are_told(truth: Callable[[Levels], float], rooms: int, words: str):
    findings = analyse_screening(Screening.make("sarsa", make_runs(truth, rooms=rooms, noise=0.05)))
    said = tell_first_look(findings, 3)
    assert words in said and bool(said) == bool(words)
    assert not tell_first_look(findings, None)


@pytest.mark.nightly
def test_a_first_look_is_at_the_first_rooms_alone():
    weak, strong = (make_runs(lambda on, height=height: 0.3 + height * on["choices"], rooms=5, noise=0.05)
                    for height in (0.03, 0.3))
    rooms = Screening.make("sarsa", weak).rooms[:3]
    looked = [run for run in weak if run.room in rooms]
    findings = analyse_screening(Screening.make("sarsa", [*looked, *(run for run in strong if run.room not in rooms)]))
    effects = analyse_screening(Screening.make("sarsa", looked)).effects
    p = next(effect.p for effect in effects if effect.factor == "choices")
    assert 0.001 < p and f"choices had p = {p:.3f}" in tell_first_look(findings, 3)


def test_two_fresh_rooms_say_nothing():
    def truth(on: Levels) -> float:
        return 0.1 + 0.5 * on["buffer"]

    again = Screening.make("sarsa", make_runs(truth, rooms=2, seeds=1, first_seed=100))
    published = analyse_screening(Screening.make("sarsa", make_runs(truth)))
    assert tell_fresh_runs(again, published) == "2 rooms and 1 training seed: too few to conclude anything."


# --- page and command ------------------------------------------------------------------


@pytest.mark.nightly
def test_the_page_is_written_from_raw_results_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    published = [run for name in ALGORITHMS
                 for run in make_runs(lambda on: 0.1 + 0.5 * on["exploration"], algorithm=name)]
    fresh = make_runs(lambda on: 0.1 + 0.5 * on["exploration"], rooms=3, seeds=1, first_seed=100)
    save("factorial", [*published, *fresh], tmp_path)
    assert main(["factorial", "--from-raw", "--docs", str(tmp_path)]) == 0, "all whose results are there"
    page = (tmp_path / "why-it-worsens.md").read_text()
    assert page.startswith("# Why SARSA and DDPG get worse with meta-actions\n")
    assert "**sarsa: One correction is shown to raise the slope: exploration (+0." in page
    assert page.count("| exploration | +0.5") == 2 and "the same conclusion" in page
    for words in ("sarsa --rooms 4 --runs 5", "ddpg --rooms 4 --runs 5", "sarsa --first-seed 100 --rooms 3 --runs 1"):
        assert f"factorial --algorithms {words} --primitives" in page
    assert (tmp_path / "figures" / "why-ddpg.svg").exists() and "was not run" not in page
    assert "One correction is shown" in capsys.readouterr().out
    assert "nobody had tried before" not in tell("factorial", published)
    page = tell("factorial", make_runs(lambda on: 0.5))
    assert page.startswith("# Why SARSA gets worse") and "DDPG is not on this page" in page


def test_the_page_tells_which_corrections_suffice_and_what_carries_them():
    runs = make_runs(lambda on: 0.1 + 0.6 * (on["exploration"] or on["buffer"]),
                     repeat=lambda on: 4.0 - 2 * on["exploration"])
    page = tell("factorial", runs)
    table = page.partition("do they bring more than three quarters")[2].partition("What the logs carry")[0]
    assert "| yes | yes |" in table and "exploration" in table and "buffer" in table
    assert "| exploration | longest repeat | -1.9" in page


def test_a_factorial_wants_an_algorithm(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["factorial", "--docs", str(tmp_path), "--algorithms"]) == 2
    assert "name one or more of sarsa, ddpg" in capsys.readouterr().err
