"""Success: what an environment reports at the last step of an episode; an environment that reports none has none."""

import json

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape import EscapeRoomEnv, OptionsEnv
from hrl_escape.agents import load_result, train
from hrl_escape.agents.agent import read_success
from hrl_escape.agents.training.callbacks import Callback, list_numbers
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.agents.training.results import METRICS
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import StepContractError
from hrl_escape.options import FunctionOption, ScriptedOption
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

BALANCE = FunctionOption("balance", policy=lambda state: int(state[2] + 0.3 * state[3] > 0), termination=lambda s: 0.0)
FALL = FunctionOption("fall", policy=lambda state: 0, termination=lambda state: 0.0)
RATES = ("train/success", "train/successes", "eval/success", "eval/successes", "eval/progress")


class Rows(Callback):
    def __init__(self):
        self.rows = []

    def on_row(self, row):
        self.rows.append(row)


class Judged(gymnasium.Env):
    """Two steps an episode. `infos` are those of the steps; the last one ends it."""

    observation_space, action_space = gymnasium.spaces.Discrete(3), gymnasium.spaces.Discrete(2)

    def __init__(self, *infos, is_cut=False):
        self.infos, self.is_cut = infos, is_cut

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.elapsed = 0
        return 0, {"is_success": True}  # of no step: never read

    def step(self, action):
        info = self.infos[self.elapsed]
        self.elapsed += 1
        is_over = self.elapsed == len(self.infos)
        return self.elapsed, 1.0, is_over and not self.is_cut, is_over and self.is_cut, dict(info)


def run(env, agent="q-learning", primitives=20, **arguments):
    return train(agent, env, primitives=primitives, eval_episodes=2, **arguments)


@pytest.mark.parametrize(("name", "arguments", "option", "length"), [
    ("CartPole-v1", {}, BALANCE, 500), ("CartPole-v1", {}, FALL, None),
    ("FrozenLake-v1", {"is_slippery": False}, ScriptedOption("into a hole", [1, 2]), 2)])
def test_an_environment_that_reports_no_success_has_none_in_results_and_logs(name, arguments, option, length, tmp_path):
    env, heard = OptionsEnv(gymnasium.make(name, **arguments), [option], include_primitives=False), Rows()
    result = run(env, "random-options", out=tmp_path, callbacks=[heard])
    assert result.episodes and result.evaluations
    if length is not None:
        assert {*result.evaluations[-1].lengths, *(each.length for each in result.episodes[:-1])} == {length}
    for found in (result, load_result(tmp_path)):
        assert {episode.success for episode in found.episodes} == {None} and found.first_escape is None
        for evaluation in found.evaluations:
            assert evaluation.successes == evaluation.progress == (None, None)
            assert evaluation.success_rate is None is evaluation.mean_progress
        assert "success" not in repr(found) and np.isnan(found.curve("success_rate")[1]).all()
    logged = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert len(logged) == len(heard.rows) and not any(set(RATES) & row.keys() for row in logged)
    assert not any(set(RATES) & list_numbers(row).keys() for row in heard.rows)
    assert run(env, "random-options", out=tmp_path) == result  # the finished run is read again
    assert set(RATES) <= set(METRICS)


@pytest.mark.parametrize(("infos", "is_cut", "success"), [
    (({}, {"is_success": True}), False, True), (({}, {"success": np.True_}), False, True),
    (({}, {"is_success": 1.0}), True, True), (({}, {"is_success": np.zeros(1)}), False, False),
    (({"is_success": True}, {"is_success": False}), False, False), (({"is_success": True}, {}), False, None),
    (({}, {"is_success": False, "success": True}), False, False), (({}, {"is_success": None}), False, None),
    (({}, {"is_success": None, "success": True}), True, True), (({}, {}), True, None)])
def test_the_last_step_decides_by_is_success_else_by_success(infos, is_cut, success):
    result = run(Judged(*infos, is_cut=is_cut))
    assert {episode.success for episode in result.episodes if episode.end != "budget"} == {success}
    rate = None if success is None else float(success)
    assert {(each.success_rate, each.mean_progress) for each in result.evaluations} == {(rate, rate)}
    assert result.first_escape == (2 if success else None)
    assert ("success" in repr(result)) == (success is not None)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.5, 2, "yes", [True, False], {"value": True}])
@pytest.mark.parametrize("name", ["is_success", "success"])
def test_a_success_that_is_neither_true_nor_false_is_refused_with_its_name_and_value(name, value):
    with pytest.raises(StepContractError, match=rf"info\['{name}'\] is .*; success must be True, False, 1 or 0"):
        run(Judged({name: value}, {name: value}))
    if not isinstance(value, (str, list, dict)):
        streams = VectorManyEnvs(SyncVectorEnv([lambda: Judged({name: value})] * 2), 0.99)
        streams.reset(0)
        with pytest.raises(StepContractError, match="success must be"):
            streams.step(torch.zeros(2, dtype=torch.int64))


def test_episodes_that_report_no_success_are_left_out_of_the_rate(tmp_path):
    class Every(Judged):
        """Only every second episode reports its success."""

        number = 0

        def reset(self, **arguments):
            Every.number += 1
            return super().reset(**arguments)

        def step(self, action):
            *rest, info = super().step(action)
            return *rest, info if Every.number % 2 else {}

    result = run(Every({}, {"is_success": True}), out=tmp_path)
    assert sorted(map(str, result.evaluations[-1].successes)) == ["None", "True"]
    assert result.evaluations[-1].success_rate == 1.0 == result.evaluations[-1].mean_progress
    assert load_result(tmp_path) == result


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_copies_report_their_success_at_their_own_last_steps(mode):
    makers = [lambda: Judged({"is_success": False}, {"is_success": True}),
              lambda: Judged({"is_success": True}, {"is_success": True}, {"is_success": False}),
              lambda: Judged({}, {}, {"success": 1}),
              lambda: Judged({"is_success": True}, {})]
    streams = VectorManyEnvs(SyncVectorEnv(makers, autoreset_mode=mode), 0.99)
    streams.reset(0)
    found = [set() for _ in makers]
    for _ in range(20):
        step = streams.step(torch.zeros(4, dtype=torch.int64))
        for stream in (step.where & (step.terminated | step.truncated)).nonzero().squeeze(1).tolist():
            found[stream].add(int(step.success[stream]))
    assert found == [{1}, {0}, {1}, {-1}]


@pytest.mark.nightly_for("AutoresetMode.SAME_STEP")
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_segments_of_copies_that_report_no_success_have_none(mode, tmp_path):
    settings = {"hidden": (8,), "rollout": 64, "rollout_per_env": 4, "epochs": 2, "batch_size": 16}
    poles = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 2, autoreset_mode=mode)
    result = run(poles, "ppo", 200, settings=settings, eval_env=gymnasium.make("CartPole-v1"), out=tmp_path)
    assert sum(segment.episodes for segment in result.segments) > 3
    assert {segment.successes for segment in result.segments} == {None}
    assert "success" not in repr(result) and load_result(tmp_path) == result
    assert "success" not in (tmp_path / "log.jsonl").read_text()


def test_rooms_report_success_whichever_engine_steps_them():
    room = EscapeRoomEnv("paper-one-button")
    _, info = room.reset(seed=0)
    *_, after = room.step(0)
    assert read_success(info) is read_success(after) is False and "success" not in after
    for kind in (EscapeRoomVectorEnv, OptionsVectorEnv):
        rooms = kind(2, "paper-one-button")
        _, infos = rooms.reset(seed=0)
        assert infos["is_success"].tolist() == [False, False] and "success" not in infos
