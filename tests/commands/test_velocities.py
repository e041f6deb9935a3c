"""`train` and `record` with agents that drive velocities."""

import pytest

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
