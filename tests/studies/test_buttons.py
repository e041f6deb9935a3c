"""First escape against buttons: runs that end with it, and rules with data of other truths."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.buttons.analysis import Args, EscapeRun, Size, analyse, find_reach, measure, run_once
from studies.pages.learning_structure import RULES
from studies.running import open_store
from studies.scaling.results import RoomKind
from studies.scaling.rounds import make_room
from studies.study import find_study

SIZES = (2, 3, 4, 6, 8, 10, 12, 15, 20)
BUDGET = 100_000
STUDY = find_study("buttons")
FLAT, OPTIONS, MEMORY, SEARCHER, STRUCTURE = STUDY.data["agents"]
OWN_RULES = ("search-is-first", "search-is-quicker", "two-reach-the-end", "others-stop")


def make_runs(agent: str, law: Callable[[int], float], spread: float = 0.2) -> list[EscapeRun]:
    """Runs whose logarithms scatter around a law; those beyond the budget do not escape."""
    rng = np.random.default_rng(7)
    times = {(size, run): law(size) * math.exp(spread * rng.normal()) for size in SIZES for run in range(10)}
    return [EscapeRun(agent, size, 20.0, run, BUDGET, round(time) if time < BUDGET else None)
            for (size, run), time in times.items()]


def find(**laws: Callable[[int], float]) -> SimpleNamespace:
    """Numbers of runs in which search needs 10 n^1.2, structure 25 n^1.2, and others stop, but for what is given."""
    truth = {FLAT: lambda n: 2_000 * n if n <= 4 else 2 * BUDGET,
             OPTIONS: lambda n: 40 * n**1.5 if n <= 12 else 2 * BUDGET,
             MEMORY: lambda n: 30 * n**1.5 if n <= 15 else 2 * BUDGET, SEARCHER: lambda n: 10 * n**1.2,
             STRUCTURE: lambda n: 25 * n**1.2} | {dict(search=SEARCHER, structure=STRUCTURE, memory=MEMORY)[name]: law
                                                  for name, law in laws.items()}
    runs = [run for agent, law in truth.items() for run in make_runs(agent, law)]
    return SimpleNamespace(buttons=analyse(STUDY, runs).numbers)


def test_medians_reach_and_ratio_are_those_of_the_runs():
    numbers = find().buttons
    assert numbers.reach == {FLAT: 4, OPTIONS: 12, MEMORY: 15, SEARCHER: 20, STRUCTURE: 20}
    assert numbers.sizes[SEARCHER][20].median == pytest.approx(10 * 20**1.2, rel=0.2)
    assert numbers.sizes[OPTIONS][20] == Size(0, 10, math.inf)
    assert numbers.ratio.mean == pytest.approx(0.4, rel=0.01) and numbers.ratio.high < 0.5
    assert all(RULES[name](find()) for name in OWN_RULES)


def test_half_of_the_runs_is_enough_to_reach_a_size_although_their_median_is_infinite():
    half = Size(5, 10, math.inf)
    assert find_reach({12: half, 15: Size(4, 10, math.inf)}) == 12 and find_reach({2: Size(4, 10, math.inf)}) == 0


@pytest.mark.parametrize(("rule", "laws"), [
    ("search-is-first", {"memory": lambda n: 9 * n**1.2 if n == 3 else 30 * n**1.5 if n <= 15 else 2 * BUDGET}),
    ("search-is-quicker", {"structure": lambda n: 12 * n**1.2}),
    ("others-stop", {"memory": lambda n: 30 * n**1.5}),
])
def test_other_truths_break_the_rules(rule: str, laws: dict[str, Callable[[int], float]]):
    assert not RULES[rule](find(**laws))


def test_a_ratio_of_runs_that_do_not_escape_is_refused():
    with pytest.raises(ComparisonError, match="not all runs of search-nearest and smdp-factored-r-max escape"):
        find(structure=lambda n: 25 * n**1.2 if n < 20 else 2 * BUDGET)


# --- real runs -------------------------------------------------------------------------------


@pytest.mark.nightly
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


@pytest.mark.nightly
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
