"""The comparison of planners: honest queries, scores that add up, files, and the command."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.planner_contenders import (
    AUTO,
    FIELDS,
    FLOORS,
    PATH,
    QueryResult,
    list_contenders,
    make_queries,
    measure,
    score_contenders,
    write_csv,
)
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GenerationError
from hrl_escape.planning.goals import is_reached
from hrl_escape.planning.paths.planners import list_planners
from tests.command_line import assert_script_refused, call_script


def test_queries_begin_at_free_places_where_something_is_left_to_do():
    queries = make_queries("10 obstacles", range(2), 2)
    assert len(queries) == 4 and len({query.search.instance.id for query in queries}) == 2
    for query in queries:
        rules, state = query.search.kinematics, query.state
        assert query.search.get_maker(True).collision.is_free(state.x, state.y)
        assert not state.touching and not is_reached(query.goal, state, state, rules)
        assert query.fewest >= 1


@pytest.mark.nightly
def test_instance_seeds_of_which_no_room_can_be_made_have_no_queries():
    crowded = RoomConfig(room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=2.2),
                         puzzle=ButtonsConfig(count=40))
    with pytest.raises(GenerationError):
        generate(crowded, 0)
    assert make_queries("crowded", range(2), 1, crowded) == []


def test_the_same_seeds_give_the_same_queries():
    one, other = (make_queries("empty", range(1), 3) for _ in range(2))
    assert [(q.state, q.goal, q.fewest) for q in one] == [(q.state, q.goal, q.fewest) for q in other]


def test_scores_are_those_of_the_measurements(tmp_path):
    rows = [QueryResult("fields", "empty", "a", "exit", True, 11, 10, 30.0, 5.0, 2.0, 8.0, 12.0),
            QueryResult("fields", "empty", "a", "exit", True, 10, 10, 50.0, 7.0, 4.0, 6.0, 10.0),
            QueryResult("fields", "empty", "a", "exit", False, 0, 10, 60.0, 9.0, 90.0, 0.0, 0.0),
            QueryResult("RRT", "empty", "a", "exit", False, 0, 10, 1.0, 1.0, 1.0, 0.0, 0.0),
            QueryResult("RRT-path", "empty", "a", "exit", True, 0, 10, 1.0, 1.0, 1.0, 5.0, 9.0)]
    fields, rrt, path = score_contenders(rows)
    assert (fields.success, fields.ratio, fields.primitives, fields.median_ms) == (2 / 3, 1.05, 10.5, 4.0)
    assert (fields.cold_ms, fields.new_ms) == (50.0, 7.0)
    assert (fields.metres, fields.seconds) == (7.0, 11.0)
    assert rrt.success == 0.0 and np.isnan(rrt.ratio) and np.isnan(rrt.metres)
    assert (path.success, path.metres, path.seconds) == (1.0, 5.0, 9.0) and np.isnan(path.primitives)
    write_csv(tmp_path / "rows.csv", rows)
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert lines[0].startswith("contender,floor,instance,goal,reached") and len(lines) == 6
    assert lines[1] == "fields,empty,a,exit,True,11,10,30,5,2,8,12"


@pytest.mark.nightly
def test_everything_that_plans_is_a_contender():
    assert list_contenders() == (AUTO, FIELDS, *list_planners(), *(name + PATH for name in list_planners()))
    rows = measure(make_queries("interior walls", range(1), 1), list_contenders())
    assert [row.contender for row in rows] == list(list_contenders())
    assert sum(row.reached for row in rows) >= len(rows) - 1


@pytest.mark.nightly
def test_a_bare_path_has_no_primitives_but_a_length_and_a_time():
    rows = measure(make_queries("10 obstacles", range(1), 3), (FIELDS, "RRTstar-path"))
    for fields, path in zip(rows[::2], rows[1::2], strict=True):
        assert path.reached and path.primitives == 0 and path.fewest == fields.fewest
        assert 0.0 < path.metres < 1.5 * fields.metres <= 1.5 * fields.primitives, "a step is of 1 m"
        assert path.seconds > path.metres and fields.seconds > fields.metres, "at 1 m/s at most"


@pytest.mark.nightly
def test_a_room_costs_more_at_first_and_least_for_a_goal_that_it_knows():
    queries = make_queries("places, 10 obstacles", range(1), 5)
    assert len({query.goal for query in queries}) == 5 and all(query.other != query.goal for query in queries)
    rows = measure(queries, (FIELDS,))
    assert sum(row.cold_ms > row.new_ms > row.milliseconds for row in rows) >= 4


@pytest.mark.nightly
def test_what_auto_finds_is_what_one_of_its_two_ways_finds():
    for floor in ("10 obstacles", "places, 10 obstacles"):
        rows = measure(make_queries(floor, range(1), 3), (AUTO, FIELDS, "RRTConnect"))
        for auto, *ways in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
            assert auto.reached and auto.primitives in [way.primitives for way in ways]


def test_without_a_reference_the_best_contender_has_the_ratio_one():
    assert not FLOORS["200 m"].has_reference
    query = dataclasses.replace(make_queries("empty", range(1), 1)[0], fewest=0)
    rows = measure([query], (FIELDS, "RRTConnect", "BITstar"))
    assert {row.fewest for row in rows} == {min(row.primitives for row in rows)}


@pytest.mark.nightly
def test_the_command_prints_writes_and_draws(tmp_path, capsys):
    csv, plot = tmp_path / "planners.csv", tmp_path / "planners.png"
    words = ["--rooms", "1", "--queries", "2", "--contenders", "fields", "RRTConnect", "--floors", "empty"]
    code, out, _ = call_script(capsys, "benchmarks.planners", *words, "--csv", csv, "--plot", plot, "--json")
    assert code == 0
    scores = json.loads(out)
    assert [(score["contender"], score["queries"]) for score in scores] == [("fields", 2), ("RRTConnect", 2)]
    assert len(csv.read_text().splitlines()) == 5
    with Image.open(plot) as picture:
        assert picture.width > 800 and len(picture.getcolors(1 << 24)) > 50
    code, out, _ = call_script(capsys, "benchmarks.planners", *words)
    assert code == 0 and "again ms" in out


@pytest.mark.parametrize(("words", "complaint"), [
    (["--contenders", "RRTConect"], "did you mean 'RRTConnect'"),
    (["--floors", "empy"], "did you mean 'empty'"),
    (["--rooms", "0"], "at least 1 room"),
])
def test_the_command_says_what_is_wrong(words, complaint, capsys):
    assert_script_refused(capsys, "benchmarks.planners", words, complaint)
