"""Training in some rooms, tests in others: the same machinery, seen rooms beside unseen ones."""

from __future__ import annotations

import csv
import dataclasses
import json

import pytest

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.reporting.report import write_markdown, write_report
from hrl_escape.benchmark.verdict import write_verdict
from hrl_escape.env.config import Between
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GridError, UnknownNameError
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.places import RunPlace
from tests.benchmark.small import SCHEMATIC, OneProcess, run_quietly

VARIED = dataclasses.replace(SCHEMATIC, horizon=60,
                             puzzle=ButtonsConfig(count=Between(2, 3), graph=GraphConfig(kind="chain"),
                                                  buttons=Panels(width=1.5)))


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Comparison:
    folder = tmp_path_factory.mktemp("split")
    InstanceSet("ten", VARIED, range(10)).save(folder / "ten.json")
    agents = ("random-options+primitives", "smdp-dqn+objects+memory+primitives", "oracle")
    grid = Grid("split", agents=tuple(map(AgentSpec.parse, agents)), train_rooms=(f"{folder}/ten.json#0..4",),
                test_rooms=(f"{folder}/ten.json#4..7",), runs=1, primitives=150, eval_every=150, eval_episodes=4,
                observation="objects")
    return run_quietly(grid, folder / "out", OneProcess())


@pytest.mark.nightly
def test_evaluations_go_round_the_test_rooms_and_scores_are_measured_room_by_room(finished: Comparison):
    assert not finished.failures
    (place,) = finished.places
    assert place.split is not None and place.instance == generate(VARIED, 4)
    ranges = {run.agent.label: result.score_range for run, result in finished.runs}
    assert len(set(map(str, ranges.values()))) == 1, "the same episodes for everybody"
    starts = ranges["oracle"].starts
    rooms = [start[-1] for start in starts]
    assert rooms == [float(int(place.split.test[n].digest[:12], 16)) for n in (0, 1, 2, 0)]
    by_name = {run.agent.name: result for run, result in finished.runs}
    assert by_name["oracle"].get_final("efficiency") == 1.0, "the planner knows every room"
    assert by_name["random-options"].get_final("efficiency") < 1.0


@pytest.mark.nightly
def test_learners_are_tested_in_rooms_they_trained_in_too(finished: Comparison):
    (place,) = finished.places
    for run, result in finished.runs:
        if run.agent.is_reference:
            assert result.seen is None
            continue
        assert result.seen is not None and result.seen_range is not None
        seen = {start[-1] for start in result.seen_range.starts}
        assert seen == {float(int(room.digest[:12], 16)) for room in place.split.train}
        assert 0.0 <= result.seen_efficiency <= 1.0


@pytest.mark.nightly
def test_report_and_tables_show_seen_rooms_beside_unseen_ones_and_the_overlap(finished: Comparison):
    summary = write_report(finished, "hrl-escape compare")
    text = (finished.out / "summary.md").read_text()
    assert f"{finished.grid.runs} runs in one set of rooms." in text
    twice = dataclasses.replace(summary, rooms=summary.rooms * 2)
    write_markdown(twice, write_verdict(summary), "hrl-escape compare", finished.out / "twice.md")
    assert "runs in each of 2 sets of rooms." in (finished.out / "twice.md").read_text()
    assert "| in rooms trained in |" in text and "4 rooms to train in, 3 to be tested in, where 0% of the rooms" in text
    assert all(agent.seen is not None for agent in summary.agents if agent.spec.name == "random-options")
    rows = list(csv.DictReader((finished.out / "results.csv").open()))
    assert [bool(row["seen_efficiency"]) for row in rows] == [True, True, False]
    page = (finished.out / "report.html").read_text()
    assert "trained in</th>" in page
    said = "Intervals for unseen rooms are two-way: they cover other rooms and other training seeds."
    oracle = summary.agents[-1].unseen
    assert said in text and said in page and oracle is not None and f"{oracle:.3f}" in text and f"{oracle:.3f}" in page


def test_a_finished_comparison_of_sets_is_kept_and_its_places_load_again(finished: Comparison):
    again = run_quietly(finished.grid, finished.out, OneProcess())
    assert again.runs == finished.runs
    (place,) = finished.places
    loaded = RunPlace.load(finished.out / "rooms", place.id)
    assert loaded.id == place.id and list(loaded.split.test.seeds) == [4, 5, 6]


def test_overlaps_of_rooms_and_tasks_are_counted():
    rooms = InstanceSet("rooms", VARIED, range(3, 9))
    counts = [len(room.targets) for room in rooms]
    assert counts[0] != counts[1], "chains of two and of three buttons: two tasks in all"
    split = RunPlace.of_split(rooms[:1], rooms).split
    assert split.room_overlap == 1 / 6 and split.task_overlap == counts.count(counts[0]) / 6
    assert RunPlace.of_split(rooms[:2], rooms[2:]).split.task_overlap == 1.0


@pytest.mark.parametrize(("fields", "words"), [
    ({"train_rooms": ("clutter#0..4",)}, "one set of test_rooms"),
    ({"train_rooms": ("clutter#0..4",) * 3, "test_rooms": ("clutter#4",) * 2}, "3 train_rooms"),
    ({"rooms": ["clutter"], "train_rooms": ["clutter#0..4"], "test_rooms": ["clutter#4"]}, "not both"),
])
def test_sets_that_do_not_go_together_are_refused(fields, words):
    with pytest.raises(GridError, match=words):
        Grid.from_dict(json.loads(json.dumps(fields)))


@pytest.mark.parametrize(("test", "fields", "words"), [
    ("four-button-chain#0..2", {}, "set observation to objects, not features"),
    ("four-button-chain#0..2", {"observation": "objects"}, r"set network to objects, in short dqn\+objects"),
    ("four-button-chain#0", {"observation": "objects", "agents": (AgentSpec("q-learning"),)}, r"such as dqn\+objects"),
    ("ladder-1/reach/test#0", {"observation": "objects"}, "has 0 joints and that of .* 3"),
])
def test_sets_of_different_room_configurations_ask_for_what_both_can_show(test, fields, words):
    grid = Grid(train_rooms=("paper-two-button#0..2",), test_rooms=(test,), **{"agents": (AgentSpec("dqn"),), **fields})
    with pytest.raises(GridError, match=words):
        grid.make_runs(grid.make_places())


def test_mixins_of_agents_are_read_from_short_texts():
    spec = AgentSpec.parse("smdp-dqn+objects+memory")
    assert spec.settings == {"network": "objects"}
    assert spec.options == OptionsView(include_primitives=False, memory=True)
    assert AgentSpec.parse("smdp-ppo+gru").settings == {"memory": "gru"}
    assert AgentSpec.parse("smdp-factored-r-max@three-parents").resolve_settings()["max_parents"] == 3
    names = ("smdp-ppo+gru", "smdp-dqn+memory", "ppo+gru", "smdp-ppo")
    assert [AgentSpec.parse(name).remembers for name in names] == [True, True, True, False]
    with pytest.raises(UnknownNameError, match="objects"):
        AgentSpec.parse("smdp-dqn+object")


def test_an_episode_s_room_hangs_on_its_seed_alone():
    rooms = InstanceSet("rooms", VARIED, range(4))
    env, recorder = make_agent_env(AgentSpec.parse("smdp-dqn+memory"), rooms, "objects", {"11": 2, "12": 0})
    seen = []
    for seed in (11, 12, 11, 13, 13):
        env.reset(seed=seed)
        seen.append(env.unwrapped.instance.seed)
    assert seen[:3] == [2, 0, 2] and seen[3] == seen[4] and recorder.states
