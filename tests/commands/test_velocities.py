"""`train`, `record` and `compare` with agents that drive velocities."""

import json
import warnings

import gymnasium
import pytest

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.benchmark.records import record_escapes
from tests.command_line import call

SMALL = ("--settings", "hidden=[8]", "batch_size=8", "warmup=20", "updates_per_step=0.1")


@pytest.mark.nightly_for("hiro", "sac")
@pytest.mark.parametrize(("agent", "more"), [
    pytest.param("hiro", ("--num-envs", "4"), id="hiro"), pytest.param("sac", (), id="sac")])
def test_a_trained_agent_is_recorded_with_its_velocities(tmp_path, capsys, agent, more):
    out = tmp_path / "run"
    code, _, error = call(capsys, "train", agent, "--room", "continuous-four-rooms", *more, "--primitives", "60",
                          "--eval-every", "60", "--eval-episodes", "0", *SMALL, "--out", str(out))
    assert code == 0, error
    code, printed, error = call(capsys, "record", str(out), "--out", str(tmp_path / "episode.html"))
    assert code == 0, error
    assert "500 primitives, return -50" in printed


def test_sets_of_rooms_have_no_velocities(capsys):
    code, _, error = call(capsys, "train", "sac", "--room", "ladder-1/pair/train", "--primitives", "60")
    assert code and "name one room" in error


@pytest.mark.filterwarnings("error:.*was the best known")
def test_returns_of_velocities_are_not_held_against_plans_in_primitives(tmp_path, capsys):
    """The untrained agent escapes from one of ten starts, in fewer seconds than the plan has primitives."""
    code, printed, error = call(capsys, "train", "sac", "--room", "continuous-four-rooms", "--primitives", "40",
                                "--eval-every", "40", "--eval-episodes", "10", "--settings", "hidden=[16]", "--json",
                                "--out", str(tmp_path / "run"))
    assert code == 0, error
    result = json.loads(printed)
    assert result["best_known"] is None
    assert any(max(found["returns"]) > -2 for found in result["evaluations"]), "an escape within two seconds"


def test_an_escape_in_one_step_of_a_second_is_no_record_of_primitives():
    at_once = Evaluation(0, 0, (-1.0,), (1,), (1,), (True,), (1.0,))
    driven = gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", config="continuous-four-rooms", time_step=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        record_escapes(driven, [0], [at_once], "sac")
    stepped = gymnasium.make("hrl_escape/EscapeRoom-v1", config="continuous-four-rooms")
    with pytest.warns(UserWarning, match="was the best known"):
        record_escapes(stepped, [0], [at_once], "dqn")


def test_rooms_are_not_compared_by_velocities(capsys):
    code, _, error = call(capsys, "compare", "--agents", "sac", "td3", "--room", "continuous-four-rooms", "--dry-run")
    assert code and "EscapeRoomContinuous-v1" in error
