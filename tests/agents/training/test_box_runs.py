"""Runs with actions in a Box: resumed to the same bits, loaded, evaluated, in one environment and in many."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import Callback, evaluate, load_agent, train
from hrl_escape.agents.training import many_envs
from hrl_escape.agents.training.checkpoint import compute_state_digest
from hrl_escape.errors import UnsupportedSpaceError

REPLAY = {"hidden": (8,), "batch_size": 8, "warmup": 30, "updates_per_step": 0.1}
SMALL = {
    "sac": REPLAY | {"hindsight_goals": 2}, "td3": REPLAY | {"hindsight_goals": 2},
    "ppo": {"hidden": (8,), "rollout": 16, "batch_size": 8, "epochs": 2},
    "hiro": REPLAY | {"window": 3}, "hrac": REPLAY | {"window": 3, "adjacency_bins": 8, "adjacency_hidden": (8,)},
    "hac": REPLAY | {"attempts": 4},
}


class Stop(Callback):
    """Interrupts the run at its second checkpoint."""

    def __init__(self):
        self.left = 2

    def on_checkpoint(self, path):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


def make(is_many):
    if is_many:
        return gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=4, max_steps=20)
    return gymnasium.make("hrl_escape/PointMaze-v1", max_steps=20)


@pytest.mark.nightly_for("td3-one", "td3-many", "hrac-one", "hrac-many", "hac-one", "sac-many",
                         "ppo-one", "hiro-one", "hiro-many")
@pytest.mark.parametrize(("name", "is_many"), [
    pytest.param(name, is_many, id=f"{name}-{'many' if is_many else 'one'}")
    for name in SMALL for is_many in (False, True)])
def test_a_killed_run_goes_on_to_the_same_bits(tmp_path, monkeypatch, name, is_many):
    monkeypatch.setattr(many_envs, "SEGMENT_PRIMITIVES", 64)  # checkpoints are made between segments
    arguments = {"primitives": 200, "settings": SMALL[name], "eval_every": 80, "eval_episodes": 1, "progress": False,
                 "checkpoint_seconds": 0}
    whole = train(name, make(is_many), **arguments)
    with pytest.raises(KeyboardInterrupt):
        train(name, make(is_many), out=tmp_path / "run", callbacks=[Stop()], **arguments)
    again = train(name, make(is_many), out=tmp_path / "run", **arguments)
    assert 0 < again.resumed_at < 200
    assert compute_state_digest(again.agent.state_dict()) == compute_state_digest(whole.agent.state_dict())
    assert again.evaluations == whole.evaluations
    loaded = load_agent(tmp_path / "run")
    found = evaluate(loaded, gymnasium.make("hrl_escape/PointMaze-v1", max_steps=20), 1)
    assert found.returns == whole.evaluations[-1].returns


@pytest.mark.parametrize("name", ["ppo", "random", pytest.param("td3", marks=pytest.mark.nightly)])
def test_vector_environments_of_gymnasium_take_actions_of_a_box(name):
    env = SyncVectorEnv([lambda: gymnasium.make("Pendulum-v1", max_episode_steps=30)] * 3)
    eval_env = gymnasium.make("Pendulum-v1", max_episode_steps=30)
    if name == "random":
        result = train(name, eval_env, primitives=60, eval_episodes=1, progress=False)
    else:
        settings = {key: value for key, value in SMALL[name].items() if key != "hindsight_goals"}
        result = train(name, env, primitives=300, settings=settings, eval_env=eval_env, eval_episodes=1, progress=False)
    assert result.primitives >= 60 and np.isfinite(result.evaluations[-1].mean_return)


@pytest.mark.parametrize("name", ["hac", "hiro", "td3"])
def test_all_episodes_may_end_together(name):
    env = SyncVectorEnv([lambda: gymnasium.make("hrl_escape/PointMaze-v1", max_steps=5)] * 2)
    result = train(name, env, primitives=80, settings=SMALL[name], eval_env=make(False), eval_episodes=1,
                   progress=False)
    assert result.primitives >= 80


def test_agents_of_discrete_actions_refuse_a_box_and_the_other_way_round():
    with pytest.raises(UnsupportedSpaceError, match="dqn chooses among Discrete"):
        train("dqn", gymnasium.make("Pendulum-v1"), primitives=10)
    with pytest.raises(UnsupportedSpaceError, match="hiro-finite"):
        train("hiro", gymnasium.make("CartPole-v1"), primitives=10)
    agent = train("ppo", gymnasium.make("Pendulum-v1"), primitives=10, eval_episodes=0, progress=False).agent
    with pytest.raises(UnsupportedSpaceError, match=r"made for a Box of shape \(1,\), and .* has 2 actions"):
        evaluate(agent, gymnasium.make("CartPole-v1"), 1)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["ppo", "sac", "td3", "hiro"])
def test_agents_drive_rooms_and_lunar_landers(name):
    pytest.importorskip("Box2D")
    settings = {key: value for key, value in SMALL[name].items() if key != "hindsight_goals"}
    for env in (gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", time_limit=5.0),
                gymnasium.make("LunarLanderContinuous-v3", max_episode_steps=50)):
        result = train(name, env, primitives=120, settings=settings, eval_episodes=1, progress=False)
        assert np.isfinite(result.evaluations[-1].mean_return)
