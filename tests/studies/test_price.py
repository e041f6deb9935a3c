"""Primitives against options: ratios that are known from one side."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_escape.files import read_toml
from studies.pages.do_options_help import RULES
from studies.price.analysis import compare_pair
from studies.price.ratios import COSTS, Middle, compare_costs, correct_prices, find_middle, measure_growth
from studies.price.runs import BUTTON_COUNTS, CONTESTANTS, PAIRS, PriceRun
from studies.statistics import compute_sign_flip_p
from studies.study import find_study


def make_line(agent: str, buttons: int, replicate: int, efficient_at: float | None, budget: int = 100_000) -> PriceRun:
    at = None if efficient_at is None or efficient_at > budget else round(efficient_at)
    return PriceRun(agent, buttons, replicate, 30, budget, at or budget, at and max(at, 1), at, 1.0, 10, 5, 2.0, "")


def make_truth(price: float, growth: float, replicates: int = 10, budget: int = 10**9) -> list[PriceRun]:
    """Options need some 1,000 primitives a button; flat `price` times as many, times `growth` for each further one."""
    rng = np.random.default_rng(7)
    lines = []
    for buttons in BUTTON_COUNTS:
        for replicate in range(replicates):
            cost = 1_000 * buttons * rng.lognormal(0, 0.2)
            paid = price * growth ** (buttons - 1) * cost * rng.lognormal(0, 0.2)
            lines += [make_line("o", buttons, replicate, cost), make_line("f", buttons, replicate, paid, budget)]
    return lines


# --- ratios --------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [10, 12, 14])
def test_interval_and_p_value_are_those_of_flipped_signs(count: int):
    """The interval holds every centre that the test of all flipped signs does not reject, and no other."""
    values = np.random.default_rng(count).normal(0.5, size=count)
    found = find_middle([(value, value) for value in values])
    assert found.factor == pytest.approx(math.exp(values.mean())) and found.knowledge == "measured"

    def test(centre: float) -> float:
        return 2 * min(compute_sign_flip_p(values - centre, "above"), compute_sign_flip_p(values - centre, "below"))

    assert found.p == pytest.approx(test(0.0))
    for end, inwards in ((math.log(found.low), 1e-6), (math.log(found.high), -1e-6)):
        assert test(end - inwards) <= 0.05 < test(end + inwards)


def test_ends_that_are_not_known_widen_the_interval_on_their_own_side():
    logs = [(1.0 + n, 1.0 + n) for n in range(10)]
    whole, bound = find_middle(logs), find_middle([*logs[:9], (10.0, math.inf)])
    assert (bound.knowledge, bound.high, bound.low) == ("bound", math.inf, whole.low) and bound.p == whole.p
    unknown = find_middle([(-math.inf, 0.0), (-math.inf, 1.0), *logs[2:]])
    assert unknown.knowledge == "unknown" and 1 < unknown.high < math.inf
    assert find_middle(logs[:9]).knowledge == "unknown"


def test_intervals_of_a_family_are_corrected_with_their_verdicts():
    lines = make_truth(price=1.1, growth=1.1)
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    alone = compare_costs(flat, options, COSTS[0])
    (together,) = correct_prices([alone])
    assert all(one.middle.low >= two.middle.low for one, two in zip(alone, together, strict=True))
    assert {ratio.middle.p < 0.05 for ratio in together} == {True, False}, "some of each"
    for ratio in together:
        assert (ratio.middle.low > 1 or ratio.middle.high < 1) == (ratio.middle.p < 0.05)


def test_rooms_in_which_chance_over_options_is_efficient_are_told_apart():
    lines = [make_line("f", 1, number, 30_000) for number in range(12)]
    lines += [make_line("o", 1, number, 0 if number < 2 else 1_000) for number in range(12)]
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    (ratio,) = compare_costs(flat, options, COSTS[0])
    assert (ratio.ready, sorted(ratio.logs)) == (2, [*range(2, 12)])
    alone = [*options, *(make_line("o", 1, number, 0) for number in range(12, 20))]
    assert compare_costs(flat, alone, COSTS[0])[0].ready == 2, "of rooms in which both were run"
    assert ratio.middle.factor == pytest.approx(30), "and not 30,000 / 30 in two of them"
    (escape,) = compare_costs(flat, options, COSTS[1])
    assert not escape.ready and len(escape.logs) == 12, "a first escape is no learning"


@pytest.mark.parametrize(("cost", "at"), [(COSTS[3], 200), (COSTS[2], 600), (COSTS[0], 800)])
def test_thresholds_are_read_from_curves(cost, at):
    curve = ((0, 0.0), (100, 0.6), (150, 0.1), (200, 0.55), (400, 0.6), (500, 0.95), (600, 0.8), (700, 0.75),
             (800, 0.9), (900, 1.0))
    run = dataclasses.replace(make_line("f", 1, 0, 800), curve=curve)
    assert cost.read(run) == (at if cost is not COSTS[2] else 500, True)
    assert (cost.read(make_line("f", 1, 0, 800)) is None) == (cost is not COSTS[0]), "lines from before have no curve"


def test_a_cost_that_was_never_paid_in_full_counts_as_more_than_was_spent():
    flat, options = make_line("f", 1, 0, None, 5_000), make_line("o", 1, 0, 100)
    (ratio,) = compare_costs([flat], [options], COSTS[0])
    assert ratio.logs[0] == (pytest.approx(math.log(50)), math.inf)
    (ratio,) = compare_costs([options], [dataclasses.replace(flat, agent="o")], COSTS[0])
    assert ratio.logs[0] == (-math.inf, pytest.approx(math.log(1 / 50)))
    soon = make_line("o", 1, 0, 1)
    (ratio,) = compare_costs([options], [soon], COSTS[0])
    assert ratio.logs[0][0] == pytest.approx(math.log(100 / soon.fewest)), "one escape at least"


# --- findings ------------------------------------------------------------------------------


def compare(lines: list[PriceRun]) -> dict[int, Middle]:
    """Corrected ratios of primitives to efficiency, by number of buttons."""
    return {ratio.buttons: ratio.middle for ratio in compare_pair(lines, "f", "o", COSTS[:1])["efficient"]}


def test_where_flat_learners_are_as_quick_every_interval_holds_1():
    assert all(found.low < 1 < found.high for found in compare(make_truth(price=1.0, growth=1.0)).values())


def test_a_price_that_grows_is_measured_with_its_growth():
    lines = make_truth(price=10.0, growth=2.0)
    assert all(found.low > 1 for found in compare(lines).values())
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    growth = find_middle(measure_growth(compare_costs(flat, options, COSTS[0])))
    assert growth.low < 2 < growth.high < 2.3


@pytest.mark.parametrize(("dearer", "is_shown"), [(10, True), (9, True), (6, False)])
def test_a_price_is_shown_where_flipped_signs_show_it_in_the_family(dearer: int, is_shown: bool):
    """Nine of ten are 0.0039, and six 0.031, which times five sizes and a growth make 0.19 (Holm)."""
    lines = [make_line(agent, buttons, replicate, 1_000 * (3 if agent == "f" and replicate < dearer else 1) + replicate)
             for agent in "of" for buttons in BUTTON_COUNTS for replicate in range(10)]
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    alone = compare_costs(flat, options, COSTS[0])[0].middle
    assert alone.low > 1 and alone.p == pytest.approx(2 * 2 ** (10 - dearer) / 1024)
    assert (compare(lines)[1].low > 1) == is_shown == (compare(lines)[1].p < 0.05)


def test_where_no_flat_run_gets_there_only_a_bound_is_known():
    found = compare(make_truth(price=10_000.0, growth=2.0, budget=100_000))
    assert {middle.knowledge for middle in found.values()} == {"bound"}
    assert 60 < found[1].low < 120, "the budget is some 100 times what options need with one button"


def test_a_smaller_budget_in_some_sizes_gives_no_factor_there():
    lines = [dataclasses.replace(line, budget=20_000, primitives=20_000, efficient_at=None)
             if line.agent == "f" and line.buttons > 3 else line for line in make_truth(price=10.0, growth=1.6)]
    ratios = compare_pair(lines, "f", "o", COSTS[:1])["efficient"]
    assert [ratio.buttons for ratio in ratios if ratio.is_short] == [4, 6]
    assert {ratio.middle.knowledge for ratio in ratios if ratio.is_short} == {"unknown"}


def test_too_few_runs_give_no_factor():
    assert {middle.knowledge for middle in compare(make_truth(10.0, 2.0, replicates=9)).values()} == {"unknown"}


@pytest.mark.parametrize(("middle", "text"), [
    (Middle("measured", 26.4, 19.0, 36.0, 0.01), "26 (19 to 36)"),
    (Middle("bound", 1_344.0, 19.0), "> 19 (mean at least 1,340)"), (Middle("unknown"), "-")])
def test_factors_have_two_digits_and_all_before_the_point(middle: Middle, text: str):
    assert str(middle) == text


def rename(lines: list[PriceRun]) -> list[PriceRun]:
    flat, options = next(iter(PAIRS.items()))
    walk = [dataclasses.replace(line, agent="random") for line in lines if line.agent == "f"]
    return [*(dataclasses.replace(line, agent={"f": flat, "o": options}[line.agent]) for line in lines), *walk]


def test_the_page_s_claim_breaks_where_options_cost_as_much():
    rule = RULES["options-cost-less"]
    for price, holds in ((100.0, True), (3.0, False)):
        found = find_study("price").analysis.analyse(find_study("price"), rename(make_truth(price, 1.0)))
        assert rule(SimpleNamespace(price=found.numbers)) == holds
        assert found.numbers.ready[1] == (0, 10) and found.numbers.arrived[6] == (10, 10)
    assert "| DQN over options | 10 of 10; " in found.tables["to_efficiency"]


def test_every_flat_learner_has_its_control_and_trials_are_in_other_rooms():
    study = find_study("price")
    agents = {learner["label"]: learner["agent"] for learner in CONTESTANTS}
    assert all(agents[options] == f"smdp-{agents[flat]}" for flat, options in PAIRS.items())
    trials = read_toml(study.folder / "trials.toml", "record of trials")["trials"]
    assert trials and not {trial["room"] for trial in trials} & set(range(30)), "rooms of runs"
