"""Trials at once: each seed comes to what it comes to alone, whatever others there are, and survives being killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import load_agent, load_result, train
from hrl_escape.errors import (
    AgentSettingsError,
    DivergenceError,
    RunMismatchError,
    UnsupportedSpaceError,
    WorkerLostError,
)
from hrl_escape.options.options_env import OptionsEnv
from tests.agents.small_envs import ButtonGrid
from tests.agents.test_resuming import flatten, read_log

SMALL = {"hidden": (16,), "batch_size": 8, "warmup": 20, "updates_per_step": 0.1, "max_grad_norm": 0.05}  # it binds
VARIANTS = {
    "dqn": ("dqn", "corrected", SMALL),
    "dqn-n-step-squared-tanh": ("dqn", "corrected", SMALL | {"n_step": 3, "loss": "squared", "double": False,
                                                            "initialisation": "orthogonal"}),
    "dqn-paper": ("dqn", "paper", {"warmup": 20}),
    "sarsa": ("sarsa", "corrected", SMALL),
    "sarsa-sampled": ("sarsa", "corrected", SMALL | {"expected": False}),
    "sarsa-paper": ("sarsa", "paper", {}),
    "q-learning": ("q-learning", "corrected", {}),
}


def make_grid():
    return ButtonGrid(horizon=60)


def make_flat_grid():
    return ButtonGrid(with_options=False, horizon=60)


def run(variant, env=make_grid, **more):
    name, recipe, settings = VARIANTS[variant]
    arguments = {"primitives": 400, "seed": 3, "eval_every": 200, "eval_episodes": 2, "checkpoint_seconds": 0}
    return train(name, env, recipe=recipe, settings=settings, **(arguments | more))


def make_room(with_options):
    env = gymnasium.make("hrl_escape/EscapeRoom-v0", config="paper-two-button", observation="features")
    return OptionsEnv(env) if with_options else env


def get_weights(result):
    state = result.agent.state_dict()
    return state["learner"]["weights"]["online"] if "learner" in state else state["table"]["values"]


def describe(result):
    """Everything about a result, to the last bit."""
    return result, flatten(result.agent.state_dict())


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("env", [make_grid, make_flat_grid])
def test_each_trial_comes_to_what_its_seed_comes_to_alone(variant, env):
    together = run(variant, env, trials=3)
    assert [result.seed for result in together] == [3, 4, 5]
    for result in together:
        alone = run(variant, env(), seed=result.seed)
        assert result == alone  # the same decisions, returns and evaluations
        np.testing.assert_allclose(get_weights(result), get_weights(alone), rtol=1e-3, atol=1e-5)
    assert together[0] != together[1]


@pytest.mark.parametrize("with_options", [True, False])
def test_trials_in_a_real_room_come_to_what_each_comes_to_alone(with_options):
    name = "smdp-dqn" if with_options else "dqn"
    arguments = {"primitives": 500, "eval_episodes": 0, "settings": {"warmup": 200}}
    together = train(name, make_room(with_options), trials=2, **arguments)
    alone = train(name, make_room(with_options), seed=1, **arguments)
    assert together[1] == alone
    np.testing.assert_allclose(get_weights(together[1]), get_weights(alone), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("variant", ["dqn", "sarsa-sampled", "sarsa-paper"])
def test_no_bit_of_a_trial_depends_on_which_others_there_are(variant):
    many, few, one = (run(variant, seed=seed, trials=trials) for seed, trials in ((3, 5), (5, 2), (6, 1)))
    assert describe(many[2]) == describe(few[0])
    assert describe(many[3]) == describe(few[1]) == describe(one[0])


def test_trials_shared_by_processes_come_to_the_same_bits():
    assert list(map(describe, run("dqn", trials=3, workers=2))) == list(map(describe, run("dqn", trials=3)))


def test_a_trained_trial_goes_on_learning_alone():
    result = run("dqn", trials=2)[0]
    before = get_weights(result).copy()
    train(result.agent, make_grid(), primitives=100, eval_episodes=0)
    assert not np.array_equal(get_weights(result), before)


def test_a_trials_share_of_the_time_is_its_own():
    started = time.perf_counter()
    results = run("dqn", trials=4)
    assert 0 < sum(result.seconds for result in results) < time.perf_counter() - started


class Interrupting(ButtonGrid):
    """All environments together raise KeyboardInterrupt at their n-th step."""

    left = 0

    def __init__(self):
        super().__init__(horizon=60)

    def step(self, action):
        Interrupting.left -= 1
        if Interrupting.left < 0:
            raise KeyboardInterrupt
        return super().step(action)


@pytest.mark.parametrize("variant", ["dqn", "sarsa", "q-learning"])
def test_interrupted_trials_resume_to_the_bits_of_uninterrupted_ones(tmp_path, variant):
    Interrupting.left = 10**9
    whole = run(variant, Interrupting, trials=3, out=tmp_path / "whole")
    steps = 10**9 - Interrupting.left
    interruptions = 0
    for share in (0.4, 0.5, 1, 1):
        Interrupting.left = int(share * steps)
        try:
            pieces = run(variant, Interrupting, trials=3, out=tmp_path / "pieces")
            break
        except KeyboardInterrupt:
            interruptions += 1
    assert interruptions == 2
    assert list(map(describe, pieces)) == list(map(describe, whole))
    for seed in (3, 4, 5):
        assert read_log(tmp_path / f"pieces/seed-{seed}") == read_log(tmp_path / f"whole/seed-{seed}")
    Interrupting.left = 0
    assert run(variant, Interrupting, trials=3, out=tmp_path / "pieces") == whole  # nothing is trained again


def test_a_trials_folder_is_that_of_an_ordinary_run(tmp_path):
    results = run("dqn", trials=2, out=tmp_path)
    assert load_result(tmp_path / "seed-4") == results[1]
    agent = load_agent(tmp_path / "seed-4", make_grid())
    assert flatten(agent.state_dict()) == flatten(results[1].agent.state_dict())
    with pytest.raises(RunMismatchError, match="primitives: 400 there, 500 now"):
        run("dqn", trials=2, out=tmp_path, primitives=500)


KILLABLE = """
import sys, time
from hrl_escape.agents import train
from tests.agents.small_envs import ButtonGrid
class Grid(ButtonGrid):
    def step(self, action):
        time.sleep({pause})
        return super().step(action)
train("q-learning", lambda: Grid(horizon=60), primitives=1_000, trials=4, workers=2, eval_every=200, eval_episodes=1,
      checkpoint_seconds=0, out=sys.argv[1])
"""


def start(folder, pause):
    return subprocess.Popen([sys.executable, "-c", KILLABLE.format(pause=pause), folder], cwd=Path(__file__).parents[2])


def count_rows(folder):
    return sum(log.read_bytes().count(b"\n") for log in folder.glob("seed-*/log.jsonl"))


def test_killed_trials_of_two_processes_resume_to_the_same_bits(tmp_path):
    pieces, whole = tmp_path / "pieces", tmp_path / "whole"
    process = start(pieces, pause=0.003)
    while count_rows(pieces) < 12:
        assert process.poll() is None, "it finished before it could be killed"
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not list(pieces.glob("seed-*/result.json"))
    deadline = time.monotonic() + 60
    while (again := start(pieces, pause=0)).wait(120) != 0:  # its children let go of the folders within moments
        assert time.monotonic() < deadline, again
    assert start(whole, pause=0).wait(120) == 0
    for seed in range(4):
        assert load_result(pieces / f"seed-{seed}") == load_result(whole / f"seed-{seed}")
        assert read_log(pieces / f"seed-{seed}") == read_log(whole / f"seed-{seed}")


def test_one_trial_that_diverges_is_named_and_the_others_are_finished(tmp_path):
    class Exploding(ButtonGrid):
        made = 0

        def __init__(self):
            super().__init__(horizon=60)
            Exploding.made += 1
            self.explodes = Exploding.made == 2

        def step(self, action):
            observation, reward, *rest, info = super().step(action)
            if self.explodes:
                reward, info = 1e35, info | {"rewards": [1e35] * info.get("duration", 1)}
            return observation, reward, *rest, info

    with pytest.raises(DivergenceError, match=r"dqn, seed 4, .*seed-4: the loss of dqn"):
        run("dqn-n-step-squared-tanh", Exploding, trials=3, out=tmp_path)
    quiet = run("dqn-n-step-squared-tanh", trials=3, seed=3)
    assert [(tmp_path / f"seed-{seed}/result.json").exists() for seed in (3, 4, 5)] == [True, False, True]
    assert load_result(tmp_path / "seed-5") == quiet[2]


def test_a_process_that_is_killed_is_named_with_its_seeds():
    class Dying(ButtonGrid):
        def step(self, action):
            os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(WorkerLostError, match=r"dqn, seeds 3, 5: their process ended with code -9"):
        run("dqn", Dying, trials=3, workers=2)


def test_an_error_in_a_process_reaches_the_caller():
    class Failing(ButtonGrid):
        def step(self, action):
            raise RuntimeError("the motor is off")

    with pytest.raises(RuntimeError, match="the motor is off"):
        run("dqn", Failing, trials=2, workers=2)


def test_what_cannot_be_trained_in_trials_is_refused_with_what_can():
    with pytest.raises(AgentSettingsError, match=r"ppo has no batched form; these have: q-learning, dqn, sarsa"):
        train("ppo", ButtonGrid, primitives=100, trials=2)
    with pytest.raises(AgentSettingsError, match="give a name"):
        train(run("q-learning", make_grid()).agent, ButtonGrid, primitives=100, trials=2)
    with pytest.raises(AgentSettingsError, match="no spec: give a function that makes one"):
        train("dqn", ButtonGrid(), primitives=100, trials=2)
    with pytest.raises(AgentSettingsError, match="trials = 0"):
        train("dqn", ButtonGrid, primitives=100, trials=0)
    with pytest.raises(UnsupportedSpaceError, match="train each seed alone"):
        train("dqn", lambda: gymnasium.make("hrl_escape/EscapeRoom-v0", observation="pixels"), primitives=100, trials=2)
