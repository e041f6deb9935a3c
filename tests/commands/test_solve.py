"""`hrl-escape solve` through the command line: tables, JSON, pictures, PDDL, exit codes."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from hrl_escape.cli import main
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.viewer.pages.offline import make_motion


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    code = main(["solve", *arguments])
    out, err = capsys.readouterr()
    return code, out, err


def test_it_prints_the_plan_part_by_part_and_runs_it(capsys):
    code, out, _ = run(capsys, "--room", "paper-one-button")
    assert code == 0
    assert "press-button-1" in out and "9 strafe-left" in out
    assert "escaped after 9 primitives, return 91, every state as predicted" in out


def test_json_tells_what_a_program_needs(capsys):
    code, out, _ = run(capsys, "--room", "clutter#2", "--goal", "press-button-2", "--json")
    report = json.loads(out)
    assert code == 0 and report["reached"] and not report["escaped"]
    assert report["plan"]["cost"] == report["primitives"] == len(report["plan"]["primitives"])
    assert report["return"] == -report["primitives"]


@pytest.mark.parametrize(("planner", "found_by"), [
    ("corridor", "RRTConnect"), ("BITstar", "BITstar"), ("auto", "joint search"),
])
def test_another_planner_is_chosen_by_name(capsys, planner, found_by):
    code, out, _ = run(capsys, "--room", "paper-two-button", "--planner", planner, "--json")
    report = json.loads(out)
    assert code == 0 and report["escaped"] and report["plan"]["planner"] == found_by


def test_noise_is_met_by_looking_as_it_goes(capsys):
    code, out, _ = run(capsys, "--room", "paper-two-button", "--set", "dynamics.noise=0.1", "dynamics.slip=0.1",
                       "--json")
    report = json.loads(out)
    assert code == 0 and report["escaped"] and "plan" not in report
    assert [decision["name"] for decision in report["decisions"]] == ["press-button-1", "press-button-2", "go-to-exit"]


@pytest.mark.nightly
def test_pictures_and_pddl_are_written(capsys, tmp_path):
    files = [tmp_path / name for name in ("map.svg", "way.gif")]
    code, out, _ = run(capsys, "--room", "paper-one-button", "--draw", str(files[0]), str(files[1]),
                       "--camera", "overhead", "--pddl", str(tmp_path / "pddl"))
    assert code == 0 and all(file.stat().st_size > 1000 for file in files)
    with Image.open(files[1]) as video:
        assert video.n_frames == 10, "the start and nine primitives"
    assert "(define (domain escape-buttons)" in (tmp_path / "pddl" / "domain.pddl").read_text()
    assert out.count("wrote") == 4


def test_a_page_shows_the_motion_with_lights_as_they_are_before_it(tmp_path):
    page = tmp_path / "way.html"
    assert main(["solve", "--room", "paper-one-button", "--goal", "press-button-1", "--draw", str(page)]) == 0
    planner = RoomPlanner(generate(get_preset("paper-one-button"), 0))
    start = planner.rules.make_state(planner.instance.starts[0])
    motion = make_trajectory(planner.plan(start, "press-button-1"))
    assert page.read_text() == make_motion(motion, planner.instance, start)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--goal", "pres-button-2"), "did you mean 'press-button-2'"),
        (("--goal", "button-2"), "did you mean 'press-button-2'"),
        (("--goal", "30,30"), "goal invalid"),
        (("--planner", "RRTConect"), "RRTConnect"),
        (("--draw", "plan.doc"), ".svg"),
        (("--camera", "side"), "overhead"),
        (("--budget", "1", "--room", "clutter"), "budget exhausted"),
    ],
)
def test_a_mistake_is_one_clear_line(capsys, arguments, message):
    code, out, err = run(capsys, *arguments)
    assert code == 2 and message in err and err.count("\n") == 1 and "Traceback" not in err


def test_it_says_by_exit_code_that_the_goal_was_not_reached(capsys):
    code, out, _ = run(capsys, "--room", "paper-two-button", "--set", "horizon=5")
    assert code == 1 and "not reached after 5 primitives" in out
