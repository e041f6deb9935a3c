"""The ladder at its own budgets: sentences from data of other truths, and a real run of each learner."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.benchmark.protocols import get_budget
from hrl_escape.errors import UnknownNameError
from studies.baseline import BaselineRun
from studies.budgets.analysis import Args, identify, measure, run_once, tell_budget
from studies.running import open_store
from studies.study import find_study
from tests.studies.pages import tell

STUDY = find_study("budgets")
PPO, DQN, DAC, MEMORY = STUDY.data["agents"]
RUNGS = ("lattice-5", "lattice")


def make_run(agent: str, rung: str, room: int, efficiency: float, primitives: int) -> BaselineRun:
    return BaselineRun("per-instance", rung, f"ladder-1/{rung}/test#{room}", agent, 0, primitives, efficiency, None,
                       float(efficiency > 0), 5, float(efficiency > 0), 900, "key")


def make_lines(efficiency: Callable[[str, str], float], primitives: int | None = None) -> list[BaselineRun]:
    """A run of each learner in ten rooms of two rungs around these efficiencies, at the rungs' own budgets."""
    rng = np.random.default_rng(primitives or 0)
    return [make_run(agent, rung, room, float(np.clip(efficiency(agent, rung) + 0.02 * rng.normal(), 0, 1)),
                     primitives or get_budget(rung))
            for agent in STUDY.data["agents"] for rung in RUNGS for room in range(10)]


@pytest.mark.nightly
def test_who_beats_the_best_searcher_is_the_headline(tmp_path: Path):
    page = tell("budgets", make_lines(lambda agent, rung: 0.95 if agent == DQN else 0.3), tmp_path)
    assert re.search(rf"\*\*1 of 4 learners beat the best searcher that learns nothing: `{re.escape(DQN)}` \(\+0\.3\d, "
                     r"\+0\.\d\d to \+0\.\d\d, over 2 rungs\)\.\*\*", page)
    assert "| rung | `random-options` |" in page and f"`{MEMORY}` |" in page
    assert "| `lattice-5` | 0.20 (10) |" in page, "who learns nothing, from the study of the ladder"
    assert "python -m studies budgets --rungs lattice-5 lattice --runs 1 --workers 2" in page
    assert "Not run yet: `reach`, `doors`, `drift`, `code`, " in page and "`switchboard`." in page
    assert (tmp_path / "figures/budgets.svg").stat().st_size > 5_000
    assert "**No learner is shown to beat the best searcher" in tell("budgets", make_lines(lambda agent, rung: 0.5))


def test_runs_with_another_budget_than_the_rungs_own_do_not_count():
    page = tell("budgets", [*make_lines(lambda agent, rung: 0.4),
                            *make_lines(lambda agent, rung: 1.0, primitives=2_000_000)])
    assert "No learner is shown to beat" in page and "80 runs, each from 16 copies" in page


def group(lines: list[BaselineRun]) -> dict[tuple[str, str], list[BaselineRun]]:
    return {(agent, rung)[::-1]: [line for line in lines if (line.agent, line.rung) == (agent, rung)]
            for agent in STUDY.data["agents"] for rung in RUNGS}


def test_what_more_primitives_bring_is_told_room_by_room():
    former = group(make_lines(lambda agent, rung: 0.5, primitives=20_000))
    told = tell_budget(group(make_lines(lambda agent, rung: {PPO: 0.8, DQN: 0.5}.get(agent, 0.3))), former, RUNGS)
    assert re.match("Beside the same learner with 20,000 primitives in one copy of the room, so that budget and copies "
                    "both differ, "
                    rf"`{re.escape(PPO)}` gains 0\.(29|30|31) ", told)
    assert f"`{DQN}` is not shown to gain or lose, " in told
    assert re.search(rf"`{re.escape(DAC)}` loses 0\.[12]\d \(0\.[12]\d to 0\.2\d, over 2 rungs\)", told)
    assert told.count("over 2 rungs") == 4
    del former["lattice", PPO], former["lattice-5", PPO]
    assert f"`{PPO}`" not in tell_budget(group(make_lines(lambda agent, rung: 0.8)), former, RUNGS)
    assert not tell_budget(group(make_lines(lambda agent, rung: 0.8)), {}, RUNGS)


def test_names_that_are_unknown_are_refused(tmp_path: Path):
    for changes, what in (({"agents": ("smdp-pqo",)}, "agent"), ({"rungs": ("latice",)}, "rung")):
        args = Args(docs=tmp_path, **changes)
        with pytest.raises(UnknownNameError, match=f"{what} of this study"):
            measure(STUDY, args, open_store(STUDY, tmp_path))


@pytest.mark.slow
def test_a_real_run_is_kept_and_not_made_twice(tmp_path: Path):
    args = Args(docs=tmp_path, rungs=("doormat",), agents=(PPO,), rooms=2, runs=1, primitives=600, workers=1)
    store = open_store(STUDY, tmp_path)
    measure(STUDY, args, store)
    lines = store.load()
    assert [(line.rooms, line.seed, line.primitives, line.episodes) for line in lines] == [
        (f"ladder-1/doormat/test#{room}", 0, 600, 5) for room in range(2)]
    assert all(line.first_escape is not None for line in lines), "a room with one button"
    text = store.path.read_text()
    measure(STUDY, args, store)
    assert store.path.read_text() == text


def test_published_runs_count_as_made_unless_something_that_decides_them_has_changed():
    for line in {line.rung: line for line in open_store(STUDY, None).load()}.values():
        number = int(re.findall(r"#(\d+)$", line.rooms)[0])
        what = (line.rung, number, line.agent, line.seed, line.primitives)
        assert identify(STUDY.data, *what) == (line.place, line.key)
        for changes in ({"copies": 4}, {"episodes": 1}):
            place, key = identify(STUDY.data | changes, *what)
            assert place == line.place and key != line.key


def test_no_run_is_begun_after_the_time_is_up():
    assert run_once(STUDY.data, "doormat", 0, PPO, 0, 600, until=0.0) is None


@pytest.mark.slow
@pytest.mark.parametrize("agent", list(STUDY.data["agents"]))
def test_every_learner_learns_from_copies_of_a_room(agent: str):
    run = run_once(STUDY.data, "pair", 0, agent, 0, 30_000)
    assert run is not None and run.escapes == 1 and run.efficiency > 0.8
