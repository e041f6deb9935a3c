"""Steps per second beside other environments."""

import json

import pytest

from tests.command_line import assert_script_refused, call_script


@pytest.mark.nightly
def test_rooms_are_compared_with_cartpole_and_taxi_in_one_run(capsys):
    code, out, err = call_script(capsys, "benchmarks.env", "--presets", "paper-one-button", "push-block",
                                 "--seconds", "0.02", "--repeats", "2", "--json")
    report = json.loads(out)
    rows = {row["name"]: row for row in report["environments"]}
    assert code == 0 and err == ""
    assert {"paper-one-button", "push-block", "CartPole-v1"} <= set(rows)
    assert any(name.startswith("Taxi-v") for name in rows)
    base = rows["CartPole-v1"]["steps_per_second"]
    assert rows["CartPole-v1"]["ratio"] == 1
    for row in rows.values():
        assert row["ratio"] == pytest.approx(row["steps_per_second"] / base)
        assert row["make_ms"] > 0 and row["reset_ms"] > 0
    assert rows["push-block"]["steps_per_second"] < rows["paper-one-button"]["steps_per_second"]


@pytest.mark.parametrize(("arguments", "words"), [
    (["--presets", "cluter"], "did you mean 'clutter'"),
    (["--repeats", "0"], "at least 1"),
])
def test_a_mistake_is_one_line_and_exit_code_2(capsys, arguments, words):
    assert_script_refused(capsys, "benchmarks.env", arguments, words)
