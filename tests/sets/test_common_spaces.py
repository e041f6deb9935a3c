"""Common spaces: what environments with different objects show of themselves to one agent."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.making import make_agent
from hrl_escape.errors import ActionError, UnsupportedError
from hrl_escape.options.memory import DecisionMemory
from hrl_escape.sets.common_spaces import CommonSpacesEnv, join_spaces
from hrl_escape.sets.instance_set import InstanceSet
from tests.sets.small import make_config

FEW, MANY = (InstanceSet(name, make_config(count, "chain"), range(3)) for name, count in (("few", 2), ("many", 4)))


def make(rooms: InstanceSet, memory: bool = True, **options: object) -> gymnasium.Env:
    env = rooms.make_env(observation="objects", options=options or True)
    return DecisionMemory(env) if memory else env


@pytest.mark.parametrize("memory", [False, True])
def test_both_environments_have_the_same_spaces_and_each_keeps_its_own_objects(memory: bool):
    envs = [make(rooms, memory) for rooms in (FEW, MANY)]
    few, many = (CommonSpacesEnv(env, *join_spaces(envs)) for env in envs)
    assert few.observation_space == many.observation_space == envs[1].observation_space
    assert few.action_space == many.action_space and few.action_space.about == envs[1].action_space.about
    observation, info = few.reset(seed=1)
    assert few.observation_space.contains(observation) and info["action_mask"].shape == (few.action_space.n,)
    legal = [few.action_space.about[action] for action in np.flatnonzero(info["action_mask"])]
    assert legal.count(None) == 6 and set(legal) - {None} <= {"button-1", "button-2", "exit"}
    rows = dict(zip(few.observation_space.rows, observation[: 5 * few._words].reshape(5, -1), strict=True))
    assert not rows["button-3"].any() and not rows["button-4"].any() and rows["exit"][0] == 1.0


def test_an_action_does_what_it_does_in_the_environment_itself():
    envs = [make(rooms, include_primitives=False) for rooms in (FEW, MANY)]
    joined, alone = CommonSpacesEnv(envs[0], *join_spaces(envs)), make(FEW, include_primitives=False)
    names = list(alone.action_space.about)
    _, info = joined.reset(seed=2)
    alone.reset(seed=2)
    for _ in range(3):
        action = int(np.flatnonzero(info["action_mask"])[-1])
        _, reward, over, cut, info = joined.step(action)
        step = alone.step(names.index(joined.action_space.about[action]))
        assert (reward, over, cut) == step[1:4] and info["duration"] == step[4]["duration"]
        assert info["action_mask"].sum() == step[4]["action_mask"].sum()
        if over:
            break
    missing = joined.action_space.about.index("button-4")
    assert not info["action_mask"][missing]
    with pytest.raises(ActionError):
        joined.step(missing)


def test_deep_sets_compute_the_same_numbers_with_and_without_absent_rows():
    envs = [make(rooms) for rooms in (FEW, MANY)]
    joined, alone = CommonSpacesEnv(envs[0], *join_spaces(envs)), envs[0]
    agents = [make_agent("smdp-dqn", env.observation_space, env.action_space, 0, network="objects")
              for env in (joined, alone)]
    (wide, info), (narrow, _) = joined.reset(seed=5), alone.reset(seed=5)
    about, values = joined.action_space.about, agents[0].compute_values(wide)
    own = [number for number, name in enumerate(about) if name not in ("button-3", "button-4")]
    assert np.allclose(values[own], agents[1].compute_values(narrow), atol=1e-6) and np.ptp(values[own]) > 0
    assert len(info["action_mask"]) == len(about) == len(own) + 2


def test_flat_environments_share_primitives_and_rows():
    envs = [rooms.make_env(observation="objects") for rooms in (FEW, MANY)]
    few = CommonSpacesEnv(envs[0], *join_spaces(envs))
    observation, _ = few.reset(seed=0)
    assert few.action_space == envs[1].action_space and observation.shape == envs[1].observation_space.shape
    assert few.step(0)[0].shape == observation.shape


def test_environments_without_anything_in_common_are_refused():
    with pytest.raises(UnsupportedError, match="observation='objects'"):
        join_spaces([rooms.make_env(observation="features") for rooms in (FEW, MANY)])
    with pytest.raises(UnsupportedError, match="hold different numbers"):
        join_spaces([make(FEW, memory=True), make(MANY, memory=False)])
    with pytest.raises(UnsupportedError, match="different primitives"):
        join_spaces([make(FEW), make(MANY, include_primitives=False)])
