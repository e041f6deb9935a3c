"""Memory of decisions in many rooms at once, against what their decisions say, and agents that train with it."""

import numpy as np
import pytest
import torch

from hrl_escape.agents import load_agent, train
from hrl_escape.env.observations.objects import OBJECT_WORDS
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.memory import MEMORY_WORDS, VectorDecisionMemory
from tests.agents.training.test_resuming import flatten
from tests.options.test_memory import make_config

LIT, PRESENT = OBJECT_WORDS.index("lit"), OBJECT_WORDS.index("present")
ROWS = ("button-1", "button-2", "button-3", "exit")


def make_streams(count, rule="ignore", observation="objects"):
    return BatchedOptionsEnv(count, make_config(rule), observation=observation, include_primitives=False)


def read(observation, words):
    return np.asarray(observation)[: len(ROWS) * len(words)].reshape(len(ROWS), -1)


def recall(history, lit):
    """The three words of every row, by their definitions, of an episode's decisions (action, lit before and after)."""
    found = np.zeros((len(ROWS), 3))
    for row in range(len(ROWS)):
        about = [n for n, (action, *_) in enumerate(history) if action == row]
        found[row, 0] = any(history[n][1] == lit and not history[n][2][row] for n in about)
        found[row, 1] = 1 / (len(history) - about[-1]) if about else 0.0
        came = [before for _, before, after in history if after[row] and not before[row]]
        found[row, 2] = 1 / (1 + sum(came[-1])) if came else 0.0
    return found


@pytest.mark.nightly_for("64-ignore", "1-reset")
@pytest.mark.parametrize(("count", "rule"), [(1, "reset"), (64, "ignore")])
def test_every_room_remembers_its_own_decisions(count, rule):
    streams, rng = VectorDecisionMemory(make_streams(count, rule)), np.random.default_rng(0)
    streams.reset(3)
    histories, checked = [[] for _ in range(count)], 0
    for _ in range(400 if count == 1 else 60):
        waiting, seen = streams.is_waiting.numpy(), streams.observation.numpy().copy()
        for room in waiting.nonzero()[0]:
            words = read(seen[room], (*OBJECT_WORDS, *MEMORY_WORDS))
            lit = tuple(words[:, LIT] > 0.5)
            np.testing.assert_allclose(words[:, -3:], recall(histories[room], lit), err_msg=f"room {room}")
            checked += bool(words[:, -3].any())
        masks = streams.action_mask.numpy()
        ended = streams.step(torch.tensor([rng.choice(mask.nonzero()[0]) for mask in masks]))
        for room in ended.where.numpy().nonzero()[0]:
            before, after = (tuple(read(part[room], (*OBJECT_WORDS, *MEMORY_WORDS))[:, LIT] > 0.5)
                             for part in (ended.observation, ended.next_observation))
            histories[room].append((int(ended.action[room]), before, after))
            words = read(ended.next_observation[room], (*OBJECT_WORDS, *MEMORY_WORDS))
            np.testing.assert_allclose(words[:, -3:], recall(histories[room], after))
            if ended.terminated[room] or ended.truncated[room]:
                histories[room] = []
    assert checked > 20, "failures were met again"


def test_observations_without_rows_are_refused():
    with pytest.raises(UnsupportedError, match="observation='objects'"):
        VectorDecisionMemory(make_streams(2, observation="features"))


@pytest.mark.nightly
def test_an_agent_trains_with_it_and_resumes_to_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 128)
    settings = {"network": "objects", "hidden": (8,), "rollout": 64, "rollout_per_env": 4, "batch_size": 16,
                "epochs": 2}
    arguments = {"primitives": 900, "eval_every": 450, "eval_episodes": 1, "settings": settings,
                 "checkpoint_seconds": 0.0}
    whole, cut = (VectorDecisionMemory(make_streams(8)) for _ in range(2))
    step, left = cut.step, iter(range(60))

    def stop(action):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return step(action)

    cut.step = stop
    result = train("smdp-ppo", whole, out=tmp_path / "whole", **arguments)
    with pytest.raises(KeyboardInterrupt):
        train("smdp-ppo", cut, out=tmp_path / "cut", **arguments)
    resumed = train("smdp-ppo", VectorDecisionMemory(make_streams(8)), out=tmp_path / "cut", **arguments)
    assert resumed == result and flatten(resumed.agent.state_dict()) == flatten(result.agent.state_dict())
    assert load_agent(tmp_path / "cut").made_for == 4
