"""Updates per second of the deep agents beside other libraries."""

import json

import pytest

from tests.command_line import call_script


@pytest.mark.slow
def test_ours_are_measured_beside_stable_baselines3_in_one_run(capsys):
    code, out, _ = call_script(capsys, "benchmarks.agents", "--updates", "40", "--rounds", "1", "--json")
    assert code == 0
    rows = json.loads(out)
    assert {"dqn", "ppo", "sarsa", "Stable-Baselines3 DQN", "Stable-Baselines3 PPO"} <= set(rows)
    ours, theirs = rows["dqn"], rows["Stable-Baselines3 DQN"]
    assert theirs["ratio"] == 1
    assert ours["ratio"] == pytest.approx(ours["updates_per_second"] / theirs["updates_per_second"], rel=0.01)
