"""DQN and PPO on CartPole-v1: solved, and with DQN still solved later; `benchmarks/classic_control.py` has more."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from benchmarks.classic_control import Peer, compare, measure
from hrl_escape.agents import train
from tests.forks import run_module

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "primitives"), [("dqn", 10_000), ("ppo", 10_000)])
def test_cartpoles_threshold_is_reached(name, primitives):
    env = gymnasium.make("CartPole-v1")
    result = train(name, env, primitives=primitives, seed=2, eval_every=2_500, eval_episodes=5)
    assert max(evaluation.mean_return for evaluation in result.evaluations) >= 475


@pytest.mark.slow
def test_dqn_holds_cartpole_to_the_end_of_its_budget():
    result = train("dqn", gymnasium.make("CartPole-v1"), primitives=40_000, seed=2, eval_every=5_000, eval_episodes=20)
    assert min(evaluation.mean_return for evaluation in result.evaluations[-3:]) >= 475


@pytest.mark.slow
def test_the_benchmark_runs_and_goes_on_where_it_was_stopped(tmp_path):
    out = tmp_path / "runs.jsonl"

    def run(*contenders):
        return run_module("benchmarks.classic_control", "--primitives", 400, "--seeds", 0, "--tasks", "CartPole-v1",
                          "--out", out, "--contenders", *contenders, cwd=ROOT, check=True).stdout

    first = run("dqn")
    assert "| CartPole-v1 | dqn | 1 |" in first and "| ppo |" not in first
    again = run("dqn", "ppo")
    assert "dqn on CartPole-v1" not in again and "ppo on CartPole-v1" in again
    assert len(out.read_text().splitlines()) == 2


class Leaning:
    """What the benchmark asks of a model of Stable-Baselines3: push against the pole's lean."""

    def predict(self, observation, deterministic):
        assert deterministic
        return np.array(int(observation[2] + observation[3] > 0)), None


@pytest.mark.nightly
def test_a_model_of_stable_baselines3_is_measured_as_our_agents_are():
    assert measure(Peer(Leaning()), gymnasium.make("CartPole-v1")) > 400  # random actions: 22


def make_runs(contender, final):
    return [{"task": "Acrobot-v1", "contender": contender, "seed": seed, "scores": [[1, -90.0], [2, float(score)]]}
            for seed, score in enumerate(final)]


@pytest.mark.parametrize(("gap", "verdict"), [(80, "dqn better"), (-80, "dqn worse"), (0, "no significant difference")])
def test_the_verdict_follows_differences_between_runs_of_one_seed(gap, verdict):
    rng = np.random.default_rng(0)
    luck, own = rng.normal(0, 300, 10), rng.normal(0, 10, 10)  # what the runs of a seed share, and what they do not
    rows = make_runs("sb3-dqn", -1000 + luck) + make_runs("dqn", -1000 + luck + own + gap)
    (line,) = compare([*rows, *make_runs("dqn-tuned", [0])]).splitlines()[2:]
    assert line.startswith("| Acrobot-v1 | dqn, sb3-dqn | 10 |") and line.endswith(f"| {verdict} |")
