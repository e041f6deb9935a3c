"""The price of flatness: ratios that are known from one side, sentences by rule, and runs that end when efficient."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.env.config import ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.best_with_options import find_best_with_options
from hrl_escape.planning.best_known import find_best_known
from studies.price.analysis import draw_price
from studies.price.contestants import (
    BUTTON_COUNTS,
    CONTESTANTS,
    EFFICIENT,
    FRESH,
    PAIRS,
    VARIANTS,
    Contestant,
    make_chain_room,
    sample_replicate_room,
)
from studies.price.ratios import COSTS, compare_costs, correct_prices, find_middle, measure_growth
from studies.price.runs import (
    PriceRun,
    compute_run_key,
    list_price_runs,
    measure_price_runs,
    run_contestant,
)
from studies.price.trials import SettingsTrial, load_trials, tell_exploration
from studies.price.words import (
    advise,
    compare_with_chance,
    conclude_prices,
    conclude_variants,
    tell_longest,
    tell_number,
    tell_ready,
    tell_visible,
)
from studies.statistics import compute_sign_flip_p
from studies.store import Store
from studies.study import find_study
from tests.studies.pages import tell

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


def conclude(lines: list[PriceRun]) -> str:
    sentence, = conclude_prices(lines, [("f", "o", COSTS[0])])
    return sentence


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


@pytest.mark.parametrize(("flat", "chance", "words"), [
    (1.0, 1.0, "A flat learner's first escape is not shown to come sooner than a random walk's"),
    (9.0, 1.0, "A flat learner that waits longer for its first escape than a random walk does wants more exploration"),
    (1.0, 9.0, "This learner finds the exit sooner than a random walk, so keep its exploration"),
])
def test_advice_follows_the_random_walk_the_price_and_the_rooms(flat: float, chance: float, words: str):
    lines = make_truth(price=50, growth=1)
    walks = [dataclasses.replace(line, agent=agent,
                                 first_escape=round(1_000 * factor * (1 + 0.2 * (-1) ** line.replicate)))
             for line in lines if line.agent == "f" for agent, factor in (("f", flat), ("random", chance))]
    told = advise([*walks, *(line for line in lines if line.agent == "o")], "f", "o", "random", COSTS[:2])
    assert told.startswith(words) and told.endswith(", or give it options, which cost a fraction.")
    ready = [*(line for line in lines if line.agent == "f"), *(make_line("o", 2, number, 0) for number in range(10))]
    assert "A room that chance over options escapes from" in advise(ready, "f", "o", "random", COSTS[:2])


def test_visible_factors_grow_with_the_spread_and_with_the_family():
    """Logs of the ratios have a deviation of 0.2 sqrt(2); a factor of exp(0.28) and more is seen by ten pairs."""
    lines = make_truth(price=50, growth=1)
    told = tell_visible(lines, "f", "o", COSTS[:1])
    factor = float(told.split("a factor of ")[1].split(" ")[0])
    assert 1.2 < factor < 1.8 and told.endswith("in all.")
    wide = [dataclasses.replace(line, efficient_at=round(line.efficient_at * 3 ** (-1) ** line.replicate))
            if line.agent == "f" and line.efficient_at else line for line in lines]
    assert float(tell_visible(wide, "f", "o", COSTS[:1]).split("a factor of ")[1].split(" ")[0]) > 2


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
    told = tell_ready(lines, "f", "o", COSTS[0])
    assert "In 2 of 12 rooms with 1 button the untrained `o` is efficient already" in told
    assert not tell_ready([line for line in lines if line.replicate > 1], "f", "o", COSTS[0])
    few = tell_ready([line for line in lines if line.replicate < 11], "f", "o", COSTS[0])
    assert "In the 9 others with 1 button `f` pays 30 times as much (median; too few rooms" in few


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


# --- sentences -----------------------------------------------------------------------------


def test_where_flat_is_free_no_price_is_shown():
    told = conclude(make_truth(price=1.0, growth=1.0))
    assert "is not shown to pay more or fewer primitives than `o` with 1, 2, 3, 4 or 6 buttons" in told
    assert "These runs do not show that the factor grows with the number of buttons" in told


def test_a_price_that_grows_is_told_with_its_growth():
    lines = make_truth(price=10.0, growth=2.0)
    told = conclude(lines)
    assert "`f` pays" in told and "with 6 buttons" in told
    assert "Each button from 1 to 6 multiplies the factor by" in told
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    growth = measure_growth(compare_costs(flat, options, COSTS[0]))
    assert growth.middle.low < 2 < growth.middle.high < 2.3


@pytest.mark.parametrize(("dearer", "told"), [(10, "pays"), (9, "pays"), (6, "is not shown to pay")])
def test_a_price_is_told_where_flipped_signs_show_it_among_all_that_is_concluded(dearer: int, told: str):
    """Nine of ten are 0.0039, and six 0.031, of which five sizes and a growth make 0.19 (Holm)."""
    lines = [make_line(agent, buttons, replicate, 1_000 * (3 if agent == "f" and replicate < dearer else 1) + replicate)
             for agent in "of" for buttons in BUTTON_COUNTS for replicate in range(10)]
    flat, options = ([line for line in lines if line.agent == name] for name in "fo")
    alone = compare_costs(flat, options, COSTS[0])[0].middle
    assert alone.low > 1 and alone.p == pytest.approx(2 * 2 ** (10 - dearer) / 1024)
    assert f"`f` {told}" in conclude(lines)


def test_where_no_flat_run_gets_there_only_a_bound_is_told():
    told = conclude(make_truth(price=10_000.0, growth=2.0, budget=100_000))
    assert "pays more than" in told and "(" not in told.split("primitives")[0]
    assert "How the factor grows with each button could not be estimated." in told
    bound = float(told.split("more than ")[1].split(" times the primitives of `o` with 1 button")[0])
    assert 60 < bound < 120, "the budget is some 100 times what options need with one button"


def test_a_price_measured_in_small_rooms_alone_grows_by_a_bound_at_least():
    told = conclude(make_truth(price=10.0, growth=20.0, budget=300_000))
    assert "times the primitives of `o` with 1 button; it pays more than" in told
    assert "Each button from 1 to 2 multiplies the factor by more" in told


def test_a_price_measured_in_three_sizes_grows_by_a_number_whatever_the_others_bound():
    """A long budget in small rooms, a short one in large rooms, where no price is given; the truth is 1.6 a button."""
    lines = [dataclasses.replace(line, **cap(line, 20_000)) if line.agent == "f" and line.buttons > 3 else line
             for line in make_truth(price=10.0, growth=1.6)]
    told = conclude(lines)
    assert "with 2 buttons and" in told and "more than" not in told
    assert "with 4 or 6 buttons its budget was smaller, so no price is given." in told
    words, = [part for part in told.split(". ") if part.startswith("Each button from 1 to 3 multiplies the factor by")]
    low, high = (float(end) for end in words.split("(")[1].rstrip(").").split(" to "))
    assert low < 1.6 < high < 2


def test_cheap_flat_learners_and_too_few_runs_are_told_as_such():
    assert "pays only" in conclude(make_truth(price=0.1, growth=1.0))
    told = conclude(make_truth(price=10.0, growth=2.0, replicates=9))
    assert told.startswith("How much `f` pays until it is efficient could not be estimated")
    lines = [line if line.agent == "f" else dataclasses.replace(line, efficient_at=None) for line in make_truth(9, 2)]
    assert conclude(lines).startswith("How much `f` pays until it is efficient could not be estimated")


@pytest.mark.parametrize(("price", "budgets", "told"), [
    (4.0, (10**9, 10**9), "pays 3."), (0.2, (10**9, 10**9), "pays only 0."),
    (1.0, (10**9, 10**9), "is not shown to pay more or fewer primitives than `o` with 1, 2, 3, 4 or 6 buttons"),
    (30.0, (20_000, 10**9), "pays more than 1"),
    (0.001, (10**9, 500), "pays less than 0.0"),
    (1.0, (500, 500), "How much `f` pays until it is efficient could not be estimated")])
def test_a_variant_is_told_beside_the_plain_learner_whichever_is_dearer(price: float, budgets: tuple[int, int],
                                                                        told: str):
    lines = [dataclasses.replace(line, **cap(line, budgets["fo".index(line.agent)])) for line in make_truth(price, 1.0)]
    assert told in conclude_variants(lines, "f", "o", COSTS[:1])[0]


def cap(line: PriceRun, budget: int) -> dict[str, int | None]:
    """Changes to a run that a budget gives up."""
    given_up = line.efficient_at is not None and line.efficient_at > budget
    return {"budget": budget} | ({"primitives": budget, "efficient_at": None} if given_up else {})


def test_chance_is_beaten_fallen_behind_or_not_told_apart():
    chance = [make_line("c", 1, n, 500 if n < 10 else None) for n in range(20)]
    for hits, words in ((20, "more than by chance"), (0, "fewer than by chance"), (10, "not told apart from chance")):
        learner = [make_line("l", 1, n, 500 if n < hits else None) for n in range(20)]
        assert compare_with_chance(learner, chance, "l", 1_000).endswith(words)
    late = [make_line("l", 1, n, 5_000) for n in range(20)]
    assert compare_with_chance(late, chance, "l", 1_000).endswith("fewer than by chance")


def test_exploration_is_said_to_help_where_two_trials_that_differ_in_it_alone_tell_so():
    default = SettingsTrial("dqn", {}, 0, 1, 100, 9_000, 0, 0.25)
    longer = dataclasses.replace(default, settings={"epsilon_steps": 60_000}, escapes=0.75)
    assert "from 25% to 75%" in tell_exploration([longer, default])
    assert not tell_exploration([longer, dataclasses.replace(default, buttons=2)])
    assert not tell_exploration([default, dataclasses.replace(longer, settings={"epsilon_steps": 9, "gamma": 0.9})])


def test_the_longest_runs_are_counted_with_what_they_paid():
    runs = [make_line("f", 1, 0, 70_000, 80_000), make_line("f", 1, 1, None, 80_000),
            make_line("f", 2, 0, None, 80_000), make_line("o", 1, 0, 100, 500)]
    told = tell_longest(runs)
    assert "80,000 primitives" in told and "`o`" not in told
    assert told.endswith("`f` in 1 of 2 with 1 button, after 70,000; `f` in 0 of 1 with 2 buttons.")
    more = [make_line("f", 1, number, 10_000 * number, 80_000) for number in (3, 1, 2)]
    assert tell_longest(more).endswith("`f` in 3 of 3 with 1 button, after 10,000 to 30,000.")


@pytest.mark.parametrize(("value", "told"), [(0.523, "0.52"), (3.44, "3.4"), (26.4, "26"), (1_344.0, "1,340")])
def test_numbers_have_two_digits_and_all_before_the_point(value: float, told: str):
    assert tell_number(value) == told


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


def test_the_figure_has_a_curve_a_learner_and_size_but_for_single_runs():
    runs = [make_line(label, buttons, number, 300.0 * buttons, 10**6)
            for label, buttons, count in (("dqn", 1, 2), ("dqn", 2, 1), ("random", 2, 1)) for number in range(count)]
    panels = draw_price(runs).get_axes()
    drawn = [[line.get_label() for line in axes.get_lines() if np.size(line.get_xdata()) > 1] for axes in panels]
    assert [len(lines) for lines in drawn] == [1, 0, 0, 0, 0] * 2
    legend = panels[len(BUTTON_COUNTS) - 1].get_legend()
    assert legend is not None and [text.get_text() for text in legend.get_texts()] == ["dqn"]


@pytest.mark.nightly
def test_the_page_tells_every_learner_and_its_figure_is_drawn(tmp_path: Path):
    labels = {contestant.label for contestant in CONTESTANTS}
    lines = [make_line(label, buttons, number, 300.0 * buttons * (1 + 30 * (label in PAIRS)))
             for label in labels for buttons in BUTTON_COUNTS for number in range(10)]
    page = tell("price", lines, tmp_path)
    conclusions = find_study("price").analysis.analyse(find_study("price"), lines).conclusions
    assert all(conclusion in page for conclusion in conclusions) and f"**{conclusions[0]}**" in page
    assert "Until its first escape" in page
    assert "31 (31 to 31) times the primitives of `options, dqn` with 1 button" in conclusions[0]
    assert all(f"| {contestant.label} | 10 of 10; " in page for contestant in CONTESTANTS)
    assert "not told apart from chance" in page
    for variant in VARIANTS:
        assert f". Until it is efficient, `{variant}` pays only 0.032 (0.032 to 0.032) times the primitives of" in page
    assert (tmp_path / "figures" / "price.svg").exists()
    assert f"kept of 0 of {len(lines)} runs; the others were made before." in page
    curved = [dataclasses.replace(line, curve=((0, 0.0), (line.primitives, 0.0))) for line in lines]
    assert f"kept of {len(lines)} of {len(lines)} runs." in tell("price", curved)
