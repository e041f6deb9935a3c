"""`hrl-escape compare` and `hrl-escape train` as a user meets them."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
import tyro

from hrl_escape.agents.recommended import RECOMMENDED
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.presets import get_grid
from hrl_escape.cli import main
from hrl_escape.commands.compare import CompareArgs
from hrl_escape.sets.room_spec import RoomSpec


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command run in this process."""
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


# --- compare ---------------------------------------------------------------------------


def test_flags_change_the_preset_and_nothing_else():
    grid = CompareArgs("quickstart", runs=3, primitives=500, eval_episodes=2).make_grid()
    assert (grid.runs, grid.primitives, grid.eval_episodes) == (3, 500, 2)
    assert grid.agents == get_grid("quickstart").agents and grid.name == "quickstart"
    other = CompareArgs("ladder", agents=("dqn", "smdp-dqn@keras-rl-2019"), room=("clutter#2",)).make_grid()
    assert other.agents == (AgentSpec("dqn"), AgentSpec("smdp-dqn", recipe="keras-rl-2019"))
    assert other.rooms == (RoomSpec("clutter#2"),) and other.name == "ladder"
    assert CompareArgs(agents=("dqn",)).make_grid().name == "comparison"


def test_sets_of_rooms_take_the_place_of_rooms():
    grid = CompareArgs(train_rooms=("clutter#0..4",), test_rooms=("clutter#4..6",)).make_grid()
    (place,) = grid.make_places()
    assert not grid.rooms and place.split is not None
    assert (list(place.split.train.seeds), list(place.split.test.seeds)) == ([0, 1, 2, 3], [4, 5])


@pytest.mark.nightly
def test_work_is_told_before_made_in_parts_and_reported_from_the_folder(capsys, tmp_path: Path):
    words = ("compare", "--agents", "random-options", "oracle", "--room", "paper-two-button", "--runs", "1",
             "--primitives", "40", "--eval-episodes", "1", "--workers", "1", "--out", tmp_path)
    code, out, _ = call(capsys, *words, "--dry-run")
    assert code == 0 and "2 runs, 2 to be made" in out and not list(tmp_path.iterdir()), "nothing was run"
    code, out, _ = call(capsys, *words, "--shard", "1/2")
    assert code == 0 and "part 1/2: 1 runs finished" in out and not (tmp_path / "report.html").exists()
    code, out, _ = call(capsys, *words, "--dry-run")
    assert "2 runs, 1 to be made" in out and " s of training on one core" in out
    code, out, _ = call(capsys, *words, "--report")
    assert code == 0 and (tmp_path / "report.html").exists() and len(list((tmp_path / "runs").iterdir())) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        CompareArgs(),
        CompareArgs("ladder", agents=("dqn", "smdp-dqn"), room=("clutter#2",), runs=3, out=Path("/tmp/a b"), ray=True),
        CompareArgs("my grid.toml", primitives=77, eval_every=7, workers=2, observation="state"),
    ],
)
def test_the_command_in_the_report_gives_the_same_arguments(arguments: CompareArgs):
    words = shlex.split(arguments.format_command())
    assert words[:2] == ["hrl-escape", "compare"]
    assert tyro.cli(CompareArgs, args=words[2:]) == arguments


def test_agents_are_shown_the_observation_that_one_of_them_needs():
    recommended = tuple(choice.label for choice in RECOMMENDED)
    assert CompareArgs(agents=recommended).make_grid().observation == "objects"
    assert CompareArgs(agents=recommended[:1]).make_grid().observation == "features"
    assert CompareArgs(agents=recommended, observation="state").make_grid().observation == "state"


def test_compare_prints_verdict_table_and_report(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    arguments = ("compare", "--agents", "random", "random-options", "--runs", 1, "--primitives", 200, "--out", tmp_path)
    code, out, err = call(capsys, *arguments)
    assert code == 0
    assert "One run a room is too few for a verdict, which takes 10." in " ".join(out.split())
    assert out.strip().endswith(f"Report: {(tmp_path / 'report.html').as_uri()}"), "the last line is a link"
    assert (tmp_path / "report.html").exists()
    assert err.count("efficiency") == 2 and "[2/2]" in err
    code, out, err = call(capsys, *arguments, "--json")
    result = json.loads(out)
    assert code == 0 and "2 of 2 runs were finished before and are kept" in err
    assert [agent["label"] for agent in result["agents"]] == ["random", "random-options"]
    assert result["verdict"][0]["kind"] == "headline" and result["failures"] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["quickstrat"], "did you mean 'quickstart'"),
        (["nowhere.toml"], "nowhere.toml: no such grid"),
        (["--agents", "dqqn"], "did you mean 'dqn'"),
        (["--room", "cluter"], "did you mean 'clutter'"),
        (["--runs", "0"], "grid.runs = 0 is not possible"),
        (["--agents", "dqn", "dqn"], "same agent label twice"),
        (["--out", "/dev/null/out"], "cannot write /dev/null/out"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                               tmp_path: Path, arguments: list[str], message: str):
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "compare", *arguments)
    assert code == 2 and message in err and len(err.splitlines()) == 1


def test_ray_that_is_not_installed_is_named_with_its_extra(capsys: pytest.CaptureFixture[str], tmp_path: Path,
                                                          monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    code, _, err = call(capsys, "compare", "--agents", "random", "--runs", 1, "--ray", "--out", tmp_path)
    assert code == 2 and "'.[ray]'" in err


def test_submitit_that_is_not_installed_is_named_with_its_extra(capsys: pytest.CaptureFixture[str], tmp_path: Path,
                                                               monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "submitit", None)
    code, _, err = call(capsys, "compare", "--agents", "random", "--runs", 1, "--slurm", 2, "--out", tmp_path)
    assert code == 2 and "'.[slurm]'" in err


@pytest.mark.parametrize(("arguments", "message"), [
    (["--ray", "--slurm", 2], "without --ray"), (["--slurm", 0], "1 or more"),
    (["--resources", "num_gpus=1"], "with --ray or --slurm"),
    (["--ray", "--resources", "num_gpus"], "name=value is needed"),
])
def test_launchers_that_do_not_go_together_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path,
                                                       arguments: list[object], message: str):
    code, _, err = call(capsys, "compare", "--agents", "random", "--runs", 1, "--out", tmp_path, *arguments)
    assert code == 2 and message in err and len(err.splitlines()) == 1


# --- train -----------------------------------------------------------------------------


@pytest.mark.nightly
def test_train_prints_the_curve_keeps_the_run_and_goes_on(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    arguments = ("train", "smdp-q-learning", "--primitives", 300, "--eval-episodes", 1, "--out", tmp_path / "run",
                 "--settings", "learning_rate=0.5", "gamma=0.95", "--json")
    code, out, _ = call(capsys, *arguments)
    first = json.loads(out)
    assert code == 0 and first["settings"]["gamma"] == 0.95 and first["primitives"] >= 300
    assert first["best_known"] == 66
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"run.json", "checkpoint.npz"}
    _, out, _ = call(capsys, *arguments)
    assert json.loads(out)["seconds"] == first["seconds"], "finished runs are not repeated"
    _, out, _ = call(capsys, *arguments[:-1])
    assert "the best known is 66" in out


@pytest.mark.nightly
def test_train_refuses_a_folder_with_another_room_or_other_settings(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    arguments = ["train", "random-options", "--primitives", 100, "--eval-episodes", 1, "--out", tmp_path]
    assert call(capsys, *arguments)[0] == 0
    code, _, err = call(capsys, *arguments, "--room", "clutter")
    assert code == 2 and "holds a run that differs in environment.arguments.instance" in err
    code, _, err = call(capsys, *arguments, "--room", "paper-two-button", "--seed", 1)
    assert code == 2 and "seed: 0 there, 1 now" in err


def test_every_setting_of_an_agent_is_listed_with_what_it_means(capsys: pytest.CaptureFixture[str]):
    code, out, _ = call(capsys, "train", "smdp-intra-option-q", "--list-settings", "--json")
    listed = json.loads(out)
    about = ("Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead "
             "and learn more slowly.")
    assert code == 0 and listed["gamma"] == {"value": 0.99, "about": about}
    assert all(entry["about"] for entry in listed.values())


@pytest.mark.nightly
def test_train_gives_intra_option_learners_their_traces(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    code, out, err = call(capsys, "train", "smdp-intra-option-q", "--primitives", 150, "--eval-episodes", 1, "--json",
                          "--out", tmp_path)
    assert code == 0, err
    assert json.loads(out)["decisions"] < 150
