"""First escape against buttons: runs that end with it, the fit of growth, and sentences from data of other truths."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.env.sampling.generation import generate
from studies.buttons.analysis import (
    Args,
    EscapeRun,
    advise,
    compare_searchers,
    draw,
    find_reach,
    fit_growth,
    list_times,
    measure,
    run_once,
    tell_growth,
    tell_reach,
    tell_searchers,
)
from studies.running import open_store
from studies.scaling.results import RoomKind
from studies.scaling.rounds import make_room
from studies.study import find_study
from tests.studies.pages import tell

SIZES = (2, 3, 4, 6, 8, 10, 12, 15, 20)
BUDGET = 100_000
LEARNER, SEARCHER = "smdp-dqn", "search-nearest"
WORDS = {LEARNER: "a learner", SEARCHER: "a searcher"}


def make_runs(law: Callable[[int], float], agent: str = LEARNER, spread: float = 0.2) -> list[EscapeRun]:
    """Runs whose logarithms scatter around a law; those beyond the budget do not escape."""
    rng = np.random.default_rng(7)
    times = {(size, run): law(size) * math.exp(spread * rng.normal()) for size in SIZES for run in range(10)}
    return [EscapeRun(agent, size, 20.0, run, BUDGET, round(time) if time < BUDGET else None)
            for (size, run), time in times.items()]


def fit(runs: list[EscapeRun]):
    return fit_growth(runs, np.random.default_rng(0))


@pytest.mark.nightly
def test_a_power_law_is_found_with_its_exponent_and_told_from_an_exponential():
    growth = fit(make_runs(lambda n: 20 * n**1.6))
    assert growth is not None and growth.low < 1.6 < growth.high and growth.high - growth.low < 0.4
    assert growth.power > 0.99 and growth.largest == 20
    low, high = growth.band[-1][1:]
    assert growth.band[-1][0] == 20 and low < 20 * 20**1.6 < high < 2 * low, "the band holds the law"
    exact = fit(make_runs(lambda n: 2.5 * n**2, spread=0))
    assert exact is not None and (exact.exponent, exact.factor) == pytest.approx((2, 2.5), rel=0.02)


def test_half_of_the_runs_is_enough_to_reach_a_size_although_their_median_is_infinite():
    half = [EscapeRun(LEARNER, 12, 20.0, run, BUDGET, 80 if run < 5 else None) for run in range(10)]
    assert find_reach(half) == 12 and not list_times(half)


@pytest.mark.nightly
def test_an_exponential_is_told_from_a_power_law():
    growth = fit(make_runs(lambda n: 30 * 1.4**n))
    assert growth is not None and growth.power < 0.01


def test_sizes_with_which_fewer_than_half_of_the_runs_escape_do_not_count():
    runs = [run for run in make_runs(lambda n: 10 * n) if run.buttons <= 6]
    failed = [EscapeRun(LEARNER, 8, 20.0, run, BUDGET, 80 if run < 4 else None) for run in range(10)]
    assert list(list_times(runs + failed)) == [2, 3, 4, 6] and find_reach(runs + failed) == 6
    assert find_reach(failed) is None
    assert fit([run for run in runs + failed if run.buttons != 2]) is None, "three sizes give no law"


@pytest.mark.nightly
def test_sentences_follow_the_data():
    def write(learner: list[EscapeRun], searcher: list[EscapeRun]) -> list[str]:
        both = {LEARNER: learner, SEARCHER: searcher}
        largest = {agent: find_reach(runs) for agent, runs in both.items()}
        return list(tell_growth({agent: fit(runs) for agent, runs in both.items()}, largest, WORDS, 20))

    slow, quick = make_runs(lambda n: 40 * n**1.5), make_runs(lambda n: 10 * n**1.5, SEARCHER)
    one, two = write(slow, quick)
    assert re.search(r"of 20 buttons; up to 20 buttons .* n\^1\.5 \(1\.\d to 1\.\d\); a power law fits better", one)
    steep, *_ = write(make_runs(lambda n: 30 * 2.2**n), quick)
    assert "up to 10 of 20 buttons" in steep and "an exponential fits better" in steep
    assert "fewer than half of the runs escape" in write(make_runs(lambda n: 2 * BUDGET), quick)[0]


@pytest.mark.parametrize(("learner", "sentence", "advice"), [
    (40, "**a searcher** needs 0.2", "Compare your learner with the searcher, not with chance"),
    (10, "**a searcher** is not shown to need more or fewer primitives than **a learner**", "Compare your learner"),
    (2, "**a searcher** needs 5", "Begin with a learner: with 20 buttons it needs fewer primitives than a searcher"),
    (BUDGET, "", "With 20 buttons no learner stands beside a searcher"),
])
def test_the_searcher_is_held_against_learners_room_by_room(learner: float, sentence: str, advice: str):
    of = {LEARNER: make_runs(lambda n: learner * n**1.5), SEARCHER: make_runs(lambda n: 10 * n**1.5, SEARCHER)}
    of[LEARNER] = [dataclasses.replace(run, first_escape=run.first_escape and round(run.first_escape * (
        1 + 0.3 * (-1) ** run.run))) for run in of[LEARNER]]
    largest = {agent: find_reach(runs) for agent, runs in of.items()}
    ratios = compare_searchers(of, largest, 20)
    assert sentence in " ".join(tell_searchers(ratios, WORDS, 20)) and advise(ratios, WORDS, 20).startswith(advice)


@pytest.mark.nightly
def test_the_figure_shows_a_power_law_only_where_no_exponential_fits_better():
    of = {LEARNER: make_runs(lambda n: 30 * 1.4**n), SEARCHER: make_runs(lambda n: 10 * n**1.5, SEARCHER)}
    (axes,) = draw(of, {agent: fit(runs) for agent, runs in of.items()}, WORDS).axes
    steep, law = (text.get_text() for text in axes.get_legend().get_texts())
    assert steep == "a learner" and "n^{1.5}" in law


@pytest.mark.parametrize(("largest", "sentence"), [
    ({LEARNER: 20, SEARCHER: 20}, "A learner and a searcher still escape with 20 buttons."),
    ({LEARNER: 4, SEARCHER: 20}, "A searcher still escapes with 20 buttons; fewer than half of the runs of a learner "
                                 "escape beyond 4 buttons."),
    ({LEARNER: None, SEARCHER: 6}, "Nobody still escapes with 20 buttons; fewer than half of the runs of a searcher "
                                   "escape beyond 6 buttons and of a learner with any number of buttons."),
    ({LEARNER: 10, SEARCHER: 10}, "Nobody still escapes with 20 buttons; fewer than half of the runs of a learner and "
                                  "a searcher escape beyond 10 buttons."),
])
def test_the_headline_says_who_arrives(largest, sentence):
    assert tell_reach(largest, WORDS, 20) == sentence


@pytest.mark.nightly
def test_a_page_of_another_truth_says_another_thing(tmp_path: Path):
    agents = list(find_study("buttons").data["agents"])
    runs = [run for agent in agents for run in make_runs(lambda n: 9 * n**1.2, agent)]
    page = tell("buttons", runs, tmp_path)
    assert page.count("with up to 20 of 20 buttons") == len(agents) and "fewer" not in page.split("\n")[2]
    laws = re.findall(r"; up to 20 buttons the number of primitives grows as n\^1\.[123] .*", page)
    assert len(laws) == len(agents) and "All rooms are 20 m wide." in page
    assert (tmp_path / "figures/buttons.svg").stat().st_size > 10_000


# --- real runs -------------------------------------------------------------------------------


def test_a_run_ends_with_its_first_escape():
    room = make_room(RoomKind("layered", 3, "ignore"), 15.0)
    run = run_once(SEARCHER, room, 3, 4, 2_000)
    assert run.width == 15.0
    room = generate(room, 4)
    env, recorder = make_agent_env(AgentSpec.parse(SEARCHER), room, "features")
    longer = train(make_reference(SEARCHER, env, recorder), env, primitives=2_000, seed=4, eval_episodes=0)
    first = next(episode for episode in longer.episodes if episode.success)
    assert run.first_escape == longer.first_escape == first.primitives
    assert run.first_escape < 500


def test_the_study_goes_on_and_stops_an_agent_that_never_escapes(tmp_path: Path):
    found = find_study("buttons")
    study = dataclasses.replace(found, data={**found.data, "sizes": [2, 3, 4], "budget": 60, "runs": 1})
    store = open_store(study, tmp_path)
    for _ in range(2):
        measure(study, Args(agents=(SEARCHER, "dqn@patient")), store)
        runs = store.load()
        assert [run.buttons for run in runs if run.agent == SEARCHER][:2] == [2, 3]
        assert [run.buttons for run in runs if run.agent == "dqn@patient"] == [2], "no walk of 60 primitives escapes"
        assert store.path.read_text().count("\n") == 1 + len(runs), "nothing is run twice"
    measure(dataclasses.replace(study, data={**study.data, "width": 21.0}), Args(agents=(SEARCHER,)), store)
    assert len(store.load()) == len(runs) + 2, "rooms of another width are other runs"
