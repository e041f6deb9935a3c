"""Primitives against options: ratios that are known from one side, and runs that end when they are efficient."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_escape.env.config import ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.best_with_options import find_best_with_options
from hrl_escape.planning.best_known import find_best_known
from studies.pages.do_options_help import RULES
from studies.price.analysis import compare_pair
from studies.price.contestants import (
    BUTTON_COUNTS,
    CONTESTANTS,
    EFFICIENT,
    FRESH,
    PAIRS,
    Contestant,
    make_chain_room,
    sample_replicate_room,
)
from studies.price.ratios import COSTS, Middle, compare_costs, correct_prices, find_middle, measure_growth
from studies.price.runs import (
    PriceRun,
    compute_run_key,
    list_price_runs,
    measure_price_runs,
    run_contestant,
)
from studies.price.trials import load_trials
from studies.statistics import compute_sign_flip_p
from studies.store import Store
from studies.study import find_study

QUICK = Contestant("options", "smdp-q-learning", 3_000, 250, (1,))


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
    (together,), _ = correct_prices([alone])
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
    growth = measure_growth(compare_costs(flat, options, COSTS[0]))
    assert (growth.smallest, growth.largest) == (1, 6) and growth.middle.low < 2 < growth.middle.high < 2.3


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


# --- rooms and runs ------------------------------------------------------------------------


@pytest.mark.nightly
def test_rooms_are_relabelled_chains_in_which_presses_can_be_efficient():
    orders = set()
    for buttons in BUTTON_COUNTS:
        room = sample_replicate_room(buttons, 0)
        ends = list(zip(*room.puzzle.edges, strict=True)) or [(), ()]
        assert len(room.targets) == buttons == len(room.puzzle.edges) + 1
        assert all(len(set(end)) == len(end) for end in ends)
        orders.add(room.puzzle.goal_targets)
    assert len(orders) > 1, "the numbers tell nothing of the order"
    efficiencies = []
    for room in (generate(make_chain_room(4), 4), sample_replicate_room(4, 0)):
        env = EscapeRoomEnv(instance=room)
        env.reset(seed=0)
        fewest = find_best_known(room, env.get_state()).primitives
        presses = find_best_with_options(room, env.get_state(), "press").primitives
        assert fewest is not None and presses is not None
        efficiencies.append(fewest / presses)
    assert efficiencies[0] < EFFICIENT <= efficiencies[1], "the first is left out"
    assert [sample_replicate_room(4, number).seed for number in range(4)] == [1, 2, 3, 5]


def test_every_flat_learner_has_its_control_and_trials_are_in_other_rooms():
    labels = {contestant.label: contestant for contestant in CONTESTANTS}
    for flat, options in PAIRS.items():
        assert labels[options].agent == f"smdp-{labels[flat].agent}"
    used = {sample_replicate_room(buttons, number).seed for buttons in BUTTON_COUNTS for number in range(10)}
    assert not used & {trial.room for trial in load_trials()}
    planned = list(list_price_runs(0, 10))
    assert len({(contestant.label, *rest) for contestant, *rest in planned}) == len(planned)


@pytest.mark.parametrize("series", [0, FRESH])
def test_a_learner_of_few_replicates_has_the_first_ones_wherever_one_begins(series: int):
    few = dataclasses.replace(QUICK, replicates=4)
    assert [replicate for _, _, replicate in list_price_runs(series, 10, (few,))] == [*range(series, series + 4)]
    assert [replicate for _, _, replicate in list_price_runs(series + 2, 10, (few,))] == [series + 2, series + 3]
    assert not list(list_price_runs(series + 4, 6, (few,)))


def test_a_run_over_presses_ends_with_two_efficient_evaluations(tmp_path: Path):
    run = run_contestant(QUICK, sample_replicate_room(1, 0), 0)
    assert run.efficient_at is not None and run.efficiency >= EFFICIENT
    assert run.efficient_at < run.primitives < QUICK.budget
    assert run.first_escape is not None and run.first_escape <= run.efficient_at
    assert run.buttons == 1 and 0 < run.escapes <= run.episodes


@pytest.mark.nightly
@pytest.mark.parametrize("streams", [0, 4])
def test_a_run_over_primitives_is_given_up_at_its_budget(streams: int):
    few = {"rollout": 256, "epochs": 1}
    flat = Contestant("ppo", "ppo", 2_048, 1_024, (1,), few, streams=streams)
    run = run_contestant(flat, sample_replicate_room(1, 0), 0)
    assert run.efficient_at is None and run.primitives == 2_048 and run.efficiency == 0
    assert (run.first_escape is not None) == (run.escapes > 0)


@pytest.mark.slow  # ten seconds: pytest -m slow tests/studies/test_price.py
def test_a_run_in_hindsight_ends_with_two_efficient_evaluations_too():
    small = dataclasses.replace(make_chain_room(1), room=ShapeConfig(width=8, depth=8))
    learner = Contestant("hindsight", "dqn", 12_000, 250, (1,), {"hindsight_goals": 4, "learning_rate": 1e-3,
                                                                 "hidden": (32, 32)})
    run = run_contestant(learner, generate(small, 0), 0)
    assert run.efficient_at is not None and run.efficiency >= EFFICIENT
    assert run.efficient_at < run.primitives < learner.budget
    assert run.first_escape is not None and run.first_escape < run.efficient_at


def test_a_setting_at_its_default_leaves_the_runs_that_are_there():
    room = sample_replicate_room(1, 0)
    named = dataclasses.replace(QUICK, settings={"gamma": 0.99, "bonus_weight": 0.0})
    assert compute_run_key(named, room, 0) == compute_run_key(QUICK, room, 0)
    other = dataclasses.replace(QUICK, settings={"gamma": 0.9})
    assert compute_run_key(other, room, 0) != compute_run_key(QUICK, room, 0)


def test_a_study_goes_on_where_it_was_stopped_and_makes_changed_runs_anew(tmp_path: Path):
    store = Store(tmp_path / "price.jsonl", (PriceRun,))
    assert not list(measure_price_runs(store, 0, 2, minutes=0, contestants=[QUICK]))
    first = next(measure_price_runs(store, 0, 2, contestants=[QUICK]))
    assert store.load() == [first]
    assert [run.replicate for run in measure_price_runs(store, 0, 2, contestants=[QUICK])] == [1]
    assert not list(measure_price_runs(store, 0, 2, contestants=[dataclasses.replace(QUICK, replicates=1)]))
    other = dataclasses.replace(QUICK, settings={"gamma": 0.95})
    assert [run.replicate for run in measure_price_runs(store, 0, 2, contestants=[other])] == [0, 1]
