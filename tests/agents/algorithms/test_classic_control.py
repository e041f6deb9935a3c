"""DQN and PPO on CartPole-v1: solved, and with DQN still solved later; `benchmarks/classic_control.py` has more."""

import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from hrl_escape.agents import train

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("name", "primitives"), [("dqn", 10_000), ("ppo", 10_000)])
def test_cartpoles_threshold_is_reached(name, primitives):
    env = gymnasium.make("CartPole-v1")
    result = train(name, env, primitives=primitives, seed=2, eval_every=2_500, eval_episodes=20)
    assert max(evaluation.mean_return for evaluation in result.evaluations) >= 475


@pytest.mark.slow
def test_dqn_holds_cartpole_to_the_end_of_its_budget():
    result = train("dqn", gymnasium.make("CartPole-v1"), primitives=40_000, seed=2, eval_every=5_000, eval_episodes=20)
    assert min(evaluation.mean_return for evaluation in result.evaluations[-3:]) >= 475


def test_the_benchmark_runs_and_goes_on_where_it_was_stopped(tmp_path):
    out = tmp_path / "runs.jsonl"

    def run(*contenders):
        command = [sys.executable, "-m", "benchmarks.classic_control", "--quick", "--tasks", "CartPole-v1",
                   "--out", out]
        return subprocess.run([*command, "--contenders", *contenders], capture_output=True, text=True, check=True,
                              cwd=ROOT).stdout

    first = run("dqn")
    assert "| CartPole-v1 | dqn | 1 |" in first and "| ppo |" not in first
    again = run("dqn", "ppo")
    assert "dqn on CartPole-v1" not in again and "ppo on CartPole-v1" in again
    assert len(out.read_text().splitlines()) == 2
