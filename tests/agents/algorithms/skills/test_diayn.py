"""DIAYN: rewards by hand, goals without the pose, skills that come apart, and the best of them in evaluation."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.single_env import serve_one
from tests.agents.running import learn

ALL = np.ones(3, np.bool_)
SMALL = {"hidden": (8,), "rollout": 32, "batch_size": 32, "epochs": 4}
ROOM = spaces.Box(np.array([-10, -10, 0, 0], np.float32), np.array([10, 10, 1, 1], np.float32))


class Bits(gymnasium.Env):
    """One decision an episode, from a place at random: three actions, which leave the bits 00, 10 or 11."""

    observation_space, action_space = ROOM, spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observe(0), {}

    def observe(self, action):
        place = self.np_random.uniform(-10, 10, 2)
        return np.r_[place, action > 0, action > 1].astype(np.float32)

    def step(self, action):
        return self.observe(action), float(action), True, False, {}


def show(agent, skill, here, there, reward=1.0, terminated=False, truncated=False):
    agent._option = skill
    serve_one(agent).observe(SMDPTransition(np.array(here, np.float32), 0, ALL, reward, reward, 1, agent.gamma,
                                            np.array(there, np.float32), ALL, terminated, truncated))


def make(**settings):
    return make_agent("diayn", ROOM, spaces.Discrete(3), 0, **(SMALL | {"options": 3} | settings))


def test_the_pose_says_nothing_to_the_discriminator_and_bits_do():
    agent = make()
    show(agent, 0, [0.5, 3.0, 0, 0], [2.5, 4.0, 1, 0])
    option = torch.tensor([1, 1])
    place = torch.tensor([[0.1, 0.2, -1, -1], [0.9, -0.7, -1, -1]])
    same, other = agent.compute_rewards(place, option).tolist()
    assert same == other
    bits = torch.tensor([[0.1, 0.2, -1, -1], [0.1, 0.2, 1, -1]])
    same, other = agent.compute_rewards(bits, option).tolist()
    assert same != other
    everything = make(goal="observation")
    same, other = everything.compute_rewards(place, option).tolist()
    assert same != other


def test_the_reward_is_the_forecast_at_the_state_reached_against_an_even_guess(monkeypatch):
    """With lambda 0 and gamma 0 the critic's target is the reward itself; the task's counts for nothing."""
    agent = make(gamma=0.0, gae_lambda=0.0, epochs=1, options=3, rollout=4)
    targets = []
    method = agent.heads.compute_option_loss
    monkeypatch.setattr(agent.heads, "compute_option_loss",
                        lambda *columns: targets.append(columns) or method(*columns))
    rng = np.random.default_rng(0)
    rows = [(skill, np.r_[rng.uniform(-5, 5, 2), rng.integers(0, 2, 2)], np.r_[rng.uniform(-5, 5, 2),
             rng.integers(0, 2, 2)]) for skill in (0, 2, 1, 0)]
    for skill, here, there in rows[:3]:
        show(agent, skill, here, there, reward=50.0)
    weights = agent.discriminator.weights.clone()
    with torch.no_grad():
        forecasts = []
        for skill, _, there in rows:
            bits = torch.from_numpy(np.r_[0, 0, 2 * there[2:] - 1].astype(np.float32))[None]
            forecasts.append(torch.softmax(agent.discriminator(bits), dim=1)[0, skill].item())
    show(agent, *rows[3], reward=50.0)
    ((_, _, skills, _, _, _, found),) = targets
    expected = [math.log(3 * forecast) for forecast in forecasts]
    assert sorted(found.tolist()) == pytest.approx(sorted(expected), abs=1e-5)
    assert sorted(skills.tolist()) == [0, 0, 1, 2]
    assert not torch.equal(agent.discriminator.weights, weights)


def test_a_skill_is_drawn_evenly_and_lasts_its_episode():
    agent = make(rollout=2_000)
    served, drawn = serve_one(agent), []
    for number in range(600):
        served.act(np.zeros(4, np.float32), ALL)
        drawn.append(agent._option)
        served.observe(SMDPTransition(np.zeros(4, np.float32), 0, ALL, 0.0, 0.0, 1, 0.9, np.zeros(4, np.float32), ALL,
                                      False, number % 5 == 4))
    episodes = np.array(drawn).reshape(-1, 5)
    assert (episodes == episodes[:, :1]).all()
    assert np.bincount(episodes[:, 0], minlength=3).min() > 20
    assert agent.log.compute_duration() == 5
    assert all(option.begin().compute_termination(np.zeros(4), ALL) == 0 for option in agent.get_options())


@pytest.mark.filterwarnings("ignore:.*collapsed")  # an episode is one decision
def test_skills_come_to_different_bits_wherever_they_are_and_the_best_one_acts():
    """log 3 nats tell three skills apart; the task pays for the last action."""
    agent = make(rollout=96, learning_rate=0.01, discriminator_rate=0.01, entropy_weight=0.02)
    learn(agent, Bits(), 1_500)
    rng = np.random.default_rng(0)
    places = [np.r_[rng.uniform(-10, 10, 2), 0, 0].astype(np.float32) for _ in range(20)]
    ways = [{int(agent.compute_policies(place, ALL)[skill].argmax()) for place in places} for skill in range(3)]
    assert all(len(way) == 1 for way in ways) and len(set.union(*ways)) == 3
    assert {agent.act_greedy(place, ALL, rng) for place in places} == {2}


def test_without_a_bit_it_says_so():
    agent = make(rollout=2)
    with pytest.warns(UserWarning, match="diayn: no component of the observation is a bit.*goal=observation"):
        for _ in range(2):
            show(agent, 0, [0.5, 3.0, 0.2, 0.4], [0.3, 0.1, 0.2, 0.4])
