"""Replay loses nothing: durations, discounts, ends and masks come back; n decisions join into one backup."""

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.agents import make_agent, make_transition
from hrl_escape.agents.agent import LearningSettings, SMDPTransition, compute_backup
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.replay import Experience, Replay, make_batch
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.errors import CheckpointError

GAMMA = 0.9
SETTINGS = LearningSettings(gamma=GAMMA)


@st.composite
def transitions(draw):
    """One decision with a recognisable observation."""
    rewards = draw(st.lists(st.integers(-5, 100), min_size=1, max_size=9))
    end = draw(st.sampled_from(["", "", "", "terminated", "truncated"]))
    mask = np.array(draw(st.lists(st.booleans(), min_size=3, max_size=3)) + [True])
    return SMDPTransition(
        np.array([draw(st.integers(-99, 99)), 1.0], np.float32),
        draw(st.integers(0, 3)),
        np.ones(4, np.bool_),
        sum(GAMMA**i * r for i, r in enumerate(rewards)),
        float(sum(rewards)),
        len(rewards),
        GAMMA ** len(rewards),
        np.array([draw(st.integers(-99, 99)), 2.0], np.float32),
        mask,
        end == "terminated",
        end == "truncated",
    )


def make_experience(transition):
    reward, bootstrap = compute_backup(transition, SETTINGS)
    return make_batch(Experience(
        transition.observation,
        transition.action_mask,
        transition.action,
        reward,
        bootstrap,
        transition.next_observation,
        transition.next_action_mask,
    ))


def make_replay(capacity, observation_shape=(2,), actions=4, **more):
    return Replay(Arrays(np.random.default_rng(0)), capacity, observation_shape, np.float32, actions, **more)


@given(decisions=st.lists(transitions(), min_size=1, max_size=20), capacity=st.integers(1, 12))
def test_trap_7_what_is_sampled_is_what_was_stored_also_after_a_checkpoint(tmp_path_factory, decisions, capacity):
    buffer = make_replay(capacity)
    for decision in decisions:
        buffer.add(make_experience(decision))
    path = tmp_path_factory.mktemp("replay") / "replay.npz"
    save_checkpoint(path, buffer.state_dict())
    restored = make_replay(capacity)
    restored.load_state_dict(load_checkpoint(path))

    kept = {}
    for decision in decisions[-capacity:]:
        discount = 0.0 if decision.terminated else GAMMA**decision.duration
        key = (*decision.observation, decision.action, *decision.next_observation, *decision.next_action_mask)
        kept.setdefault(key, set()).add((np.float32(decision.reward), np.float32(discount)))
    batch = restored.sample(64)
    for row in zip(*batch, strict=True):
        observation, mask, action, reward, bootstrap, next_observation, next_mask = row
        assert mask.all()
        assert (reward, bootstrap) in kept[(*observation, action, *next_observation, *next_mask)]
    for original, again in zip(buffer.sample(64), batch, strict=True):
        assert (original == again).all()


def test_sampling_reaches_every_stored_decision_and_no_other():
    buffer = make_replay(5, (1,), 2)
    for number in range(8):
        mask = np.ones(2, np.bool_)
        buffer.add(make_batch(Experience(np.float32([number]), mask, 0, number, 0.5, np.float32([number]), mask)))
    assert set(buffer.sample(500).reward) == {3, 4, 5, 6, 7}


def test_a_checkpoint_of_other_spaces_is_refused():
    buffer = make_replay(5, (1,), 2)
    mask = np.ones(2, np.bool_)
    buffer.add(make_batch(Experience(np.float32([1]), mask, 0, 1.0, 0.5, np.float32([1]), mask)))
    with pytest.raises(CheckpointError, match="observation of shape"):
        make_replay(5, (3,), 2).load_state_dict(buffer.state_dict())


def join_by_hand(decisions, n):
    """Backups of up to n decisions from each, primitive by primitive, to the episode's end or the last decision."""
    backups = []
    for first in range(len(decisions)):
        reward, elapsed = 0.0, 0
        for last in range(first, min(first + n, len(decisions))):
            reward += GAMMA**elapsed * decisions[last].reward
            elapsed += decisions[last].duration
            if decisions[last].terminated or decisions[last].truncated:
                break
        backups.append((decisions[first].action, reward, 0.0 if decisions[last].terminated else GAMMA**elapsed,
                        *decisions[last].next_observation, *decisions[last].next_action_mask))
    return backups


@given(decisions=st.lists(transitions(), min_size=1, max_size=20), n=st.integers(1, 5), capacity=st.integers(1, 25))
def test_trap_8_n_step_returns_multiply_each_gamma_k_and_stop_at_ends(decisions, n, capacity):
    replay = make_replay(capacity, n_step=n)
    for decision in decisions:
        over = np.array([decision.terminated or decision.truncated])
        replay.add(make_experience(decision), np.zeros(1, np.int64), over)
    order = np.arange(max(len(decisions) - capacity, 0), len(decisions))  # the oldest were overwritten
    found = replay.take(order % capacity)
    got = zip(found.action, found.reward, found.bootstrap, found.next_observation, found.next_mask, strict=True)
    for one, number in zip(got, order, strict=True):
        action, reward, bootstrap, following, mask = one
        expected = join_by_hand(decisions, n)[number]
        assert (action, reward, bootstrap, *following, *mask) == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(("name", "settings", "metric"), [
    ("dqn", {"warmup": 5}, "loss"), ("sarsa", {"warmup": 5}, "loss"),
    ("sarsa", {"warmup": 5, "replay_capacity": 0}, "loss"),
    ("ddpg", {"warmup": 5, "actor_warmup": 0}, "loss"), ("ddpg", {"warmup": 0, "actor_warmup": 5}, "actor_loss"),
], ids=["dqn", "sarsa", "sarsa without replay", "critic", "actor"])
def test_a_warm_up_of_five_primitives_ends_with_the_fifth_and_the_sixth_is_learned_from(name, settings, metric):
    space = spaces.Box(-1, 1, (2,), np.float32)
    agent = make_agent(name, space, spaces.Discrete(3), 0, hidden=(8,), batch_size=2, updates_per_step=1.0, **settings)
    learned, mask = [], np.ones(3, np.bool_)
    for duration in (2, 2, 1, 1, 2):
        step = (space.sample(), -float(duration), False, False, {"duration": duration, "rewards": [-1.0] * duration})
        served = serve_one(agent)
        transition = make_transition(space.sample(), served.act(space.sample(), mask), mask, step, agent.gamma)
        learned.append(metric in served.observe(transition))
    assert learned == [False, False, False, True, True]
