"""Rooms with options as a Gymnasium vector environment: decisions, resets and masks, room by room those of one."""

import gymnasium
import numpy as np
import pytest
import torch

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import train
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.errors import ActionError
from hrl_escape.options.batched.env import ENDINGS
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

MODES = ["NextStep", "SameStep", "Disabled"]


def make(count=6, **arguments):
    return gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=count,
                              **{"observation": "state"} | arguments)


def test_a_step_is_one_decision_of_every_room_with_the_fields_of_options_env():
    many, one = make(), gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", observation="state")
    assert isinstance(many.unwrapped, OptionsVectorEnv) and many.single_action_space.n == one.action_space.n
    seen, infos = many.reset(seed=0)
    assert many.observation_space.contains(seen) and infos["action_mask"].shape == (6, many.single_action_space.n)
    one.reset(seed=0)
    choices = np.array([0, 3, 6, 6, 7, 4])  # primitives, press-button-1 and press-button-2 side by side
    seen, reward, terminated, truncated, infos = many.step(choices)
    assert infos["duration"][[0, 1, 5]].tolist() == [1, 1, 1] and infos["duration"][2] > 3
    for room, action in enumerate(choices):
        one.reset(seed=room)
        expected, its_reward, _, _, info = one.step(action)
        assert infos["duration"][room] == info["duration"] and reward[room] == its_reward
        assert infos["discounted_reward"][room] == pytest.approx(info["discounted_reward"], abs=1e-4)
        assert infos["action_mask"][room].tolist() == info["action_mask"].astype(bool).tolist()
        assert ENDINGS[infos["ended"][room]] == info["option"]["ended"]
        assert infos["pressed"][room].tolist() == info["pressed"].tolist() and info["pressed"].dtype == np.int8
        assert seen[room] == pytest.approx(expected, abs=1e-4)
    assert not terminated.any() and not truncated.any()


@pytest.mark.nightly_for("SameStep", "Disabled")
@pytest.mark.parametrize("mode", MODES)
def test_episodes_end_and_begin_anew_in_each_way_and_no_outcome_is_of_the_next(mode):
    many = make(4, autoreset_mode=mode, include_primitives=False, output="torch")
    streams = VectorManyEnvs(many.unwrapped, 0.99)
    streams.reset(0)
    start, escapes = streams.observation.clone(), 0
    for decision in (0, 1, 2, 0, 1, 2, 0):  # both buttons, then the exit, and again
        waiting = streams.is_waiting
        step = streams.step(torch.where(waiting, decision if mode != "NextStep" else escapes_next(streams), 0))
        escapes += int(step.terminated.sum())
        rows = step.where & step.terminated
        assert not (step.next_observation[rows] == start[rows]).all(dim=1).any()
        assert (step.duration[step.where] >= 1).all()
        again = streams.observation[rows]
        assert mode == "NextStep" or torch.equal(again, start[rows])
    assert escapes >= 4


def escapes_next(streams):
    """The next useful option of each room: what is unlit, in order, then the exit."""
    lit = streams.observation[:, 6:8] > 0.5
    return torch.where(~lit[:, 0], 0, torch.where(~lit[:, 1], 1, 2))


def test_rooms_stand_still_until_the_last_decision_has_ended():
    many = make(2, include_primitives=True)
    before, _ = many.reset(seed=1)
    seen, *_, infos = many.step(np.array([4, 7]))
    assert infos["duration"].tolist()[0] == 1 < infos["duration"][1]
    assert (seen[0, :2] == before[0, :2]).all(), "one turn, whatever the other room did meanwhile"


def test_actions_outside_the_table_are_refused():
    many = make(2)
    many.reset(seed=0)
    with pytest.raises(ActionError):
        many.step(np.array([0, 99]))


@pytest.mark.nightly
def test_training_takes_the_rooms_each_at_its_own_pace():
    result = train("smdp-ppo+primitives", make(4, observation="features"), primitives=150, eval_episodes=0,
                   settings={"hidden": (8,), "rollout": 16, "rollout_per_env": 2, "epochs": 1})
    assert result.decisions < result.primitives and result.segments
