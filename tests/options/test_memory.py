"""Memory of decisions in rows of objects, and what options say they are about, in real rooms."""

import pickle

import numpy as np
import pytest

import hrl_escape  # noqa: F401  # registers environments
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.env.config import Between, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.observations.objects import OBJECT_WORDS
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.memory import MEMORY_WORDS, DecisionMemory
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.instance_set import InstanceSet

WORDS = OBJECT_WORDS + MEMORY_WORDS
QUICK = RobotConfig(body_radius=0.4, turn_step_deg=30)


def make_config(rule="ignore", count=3, kind="chain"):
    graph = GraphConfig(kind=kind, relabel=False)
    return RoomConfig(room=ShapeConfig(width=8, depth=8), robot=QUICK, horizon=120,
                      puzzle=ButtonsConfig(count=count, graph=graph, on_violation=rule, buttons=Panels(width=1.0)))


def make_env(config):
    return DecisionMemory(OptionsEnv(EscapeRoomEnv(config, observation="objects"), include_primitives=False))


def read(env, observation):
    """`failed`, `recent` and `rank` of every row."""
    rows = len(env.observation_space.rows)
    return observation[: rows * len(WORDS)].reshape(rows, -1)[:, -len(MEMORY_WORDS):].astype(np.float64)


def test_options_say_what_they_are_about():
    env = OptionsEnv(EscapeRoomEnv(make_config(), observation="objects"))
    assert env.action_space.about[-4:] == ("button-1", "button-2", "button-3", "exit")
    assert set(env.action_space.about[:-4]) == {None}
    assert env.observation_space.rows == ("button-1", "button-2", "button-3", "exit")


def test_failures_ages_and_ranks_are_remembered_beside_each_object():
    env = make_env(make_config())
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation) and not read(env, observation).any()
    observation, *_ = env.step(1)  # the second of the chain: too early
    np.testing.assert_allclose(read(env, observation)[:3], [[0, 0, 0], [1, 1, 0], [0, 0, 0]])
    observation, *_ = env.step(0)
    np.testing.assert_allclose(read(env, observation)[:3], [[0, 1, 1], [0, 1 / 2, 0], [0, 0, 0]],
                               err_msg="with another button lit, what failed before may succeed")
    observation, *_ = env.step(1)
    np.testing.assert_allclose(read(env, observation)[:3], [[0, 1 / 2, 1], [0, 1, 1 / 2], [0, 0, 0]])
    observation, *_ = env.step(3)  # the exit is shut
    assert read(env, observation)[3].tolist() == [1, 1, 0]
    observation, _ = env.reset(seed=0)
    assert not read(env, observation).any()


def test_what_failed_is_known_again_when_all_lights_have_gone_out():
    env = make_env(make_config("reset"))
    env.reset(seed=0)
    env.step(2)  # fails with none lit
    env.step(0)
    observation, *_ = env.step(2)  # fails with one lit, and puts it out
    failed, _, rank = read(env, observation).T
    assert failed.tolist() == [0, 0, 1, 0] and rank.tolist() == [1, 0, 0, 0]


def test_absent_buttons_keep_empty_rows_and_other_views_are_refused():
    rooms = InstanceSet("varied", make_config(count=Between(2, 4)), range(6))
    env = DecisionMemory(rooms.make_env(options=True, observation="objects"))
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        for _ in range(3):
            observation, *_ = env.step(env.action_space.n - 1)
        rows = observation[: 5 * len(WORDS)].reshape(5, -1)
        assert not rows[rows[:, 0] == 0].any() and env.observation_space.contains(observation)
    with pytest.raises(UnsupportedError, match="observation='objects'"):
        DecisionMemory(rooms.make_env(options=True))
    with pytest.raises(UnsupportedError, match="OptionsEnv"):
        DecisionMemory(rooms.make_env(observation="objects"))


@pytest.mark.slow
def test_what_is_learned_about_few_buttons_holds_for_more_with_deep_sets_and_not_with_a_perceptron():
    rooms = InstanceSet("small", make_config(count=Between(2, 5), kind="layered"), range(24))
    few, many = (rooms.filter(lambda room, counts=counts: len(room.targets) in counts)[:4] for counts in ((2, 3), (5,)))
    seen, unseen = (DecisionMemory(each.make_env(options={"include_primitives": False}, observation="objects"))
                    for each in (few, many))
    success = {}
    for network in ("objects", "mlp"):
        settings = {"network": network, "rollout": 32, "batch_size": 32, "epochs": 8}
        agent = train("smdp-ppo", seen, primitives=3_000, seed=1, settings=settings, eval_episodes=0).agent
        success[network] = [evaluate(agent, env, 6).success_rate for env in (seen, unseen)]
    assert success["objects"] == [1.0, 1.0]
    assert success["mlp"][0] >= 0.6 and success["mlp"][1] == 0.0


def test_a_memory_can_be_pickled_amid_an_episode():
    env = make_env(make_config())
    env.reset(seed=0)
    env.step(1)
    copied = pickle.loads(pickle.dumps(env))
    for action in (0, 2, 1):
        step, other = env.step(action), copied.step(action)
        np.testing.assert_array_equal(step[0], other[0])
        assert step[1:4] == other[1:4]
    assert read(env, step[0])[2].any(), "what was tried is remembered"
