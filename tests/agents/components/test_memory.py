"""Recurrent memory: what is lived through again is what was lived, episodes begin empty, and a T-maze is solved."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from hrl_escape.agents import evaluate, train
from hrl_escape.agents.algorithms.ppo import PPO, PPOSettings
from hrl_escape.agents.components.memory import cut_stretches
from hrl_escape.agents.decisions import Moments
from hrl_escape.agents.many_envs import gather_decisions
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.checks.agent import check_agent
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.options.options_env import OptionsEnv
from tests.agents.training.test_resuming import flatten

CORRIDOR = 4
SEEN = spaces.Box(-1.0, 1.0, (2,), np.float32)
SMALL = {"hidden": (16,), "memory": "gru", "memory_units": 8, "rollout": 64, "rollout_per_env": 8}


class TMaze(gymnasium.Env):
    """A sign at the start says to which side the reward lies, `CORRIDOR` steps on (Bakker 2002).

    Shows (sign at the start else 0, 1 at the junction). Actions: on, left, right. A turn before the junction stays in
    place; a step costs 0.1, and the right turn earns 1. The best return is 1 - 0.1 (CORRIDOR + 1); one who forgets the
    sign earns half of the 1 on average.
    """

    observation_space, action_space = SEEN, spaces.Discrete(3)
    BEST, FORGETFUL = 1 - 0.1 * (CORRIDOR + 1), 0.5 - 0.1 * (CORRIDOR + 1)

    def __init__(self):
        self.batch = TMazes(1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, _ = self.batch.reset(seed=seed)
        return observation[0], {}

    def step(self, action):
        observation, reward, terminated, truncated, _ = self.batch.step(np.array([action]))
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}


class TMazes(VectorEnv):
    """Many of them."""

    def __init__(self, num_envs):
        self.num_envs, self.single_observation_space, self.single_action_space = num_envs, SEEN, spaces.Discrete(3)
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED}

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.rng = np.random.default_rng(seed)
            self.sign, self.at, self.spent = (np.zeros(self.num_envs, int) for _ in range(3))
        mask = np.ones(self.num_envs, bool) if options is None else options["reset_mask"]
        self.sign[mask] = 2 * self.rng.integers(2, size=mask.sum()) - 1
        self.at[mask] = self.spent[mask] = 0
        return self.observe(), {}

    def observe(self):
        return np.stack([self.sign * (self.at == 0), self.at == CORRIDOR], axis=1).astype(np.float32)

    def step(self, actions):
        turns = (self.at == CORRIDOR) & (actions > 0)
        right = turns & ((actions == 2) == (self.sign > 0))
        self.at = np.minimum(self.at + (actions == 0), CORRIDOR)
        self.spent = self.spent + 1
        return self.observe(), right - 0.1, turns, ~turns & (self.spent >= 20), {}


def play(agent, mazes, steps):
    """Let an agent learn nothing while streams run; returns what it remembers of them."""
    streams = VectorManyEnvs(mazes, agent.gamma)
    streams.reset(0)
    agent.begin_episodes(mazes.num_envs, torch.device("cpu"))
    for _ in range(steps):
        mask = streams.action_mask
        action = agent.act(Moments(torch.arange(mazes.num_envs), streams.observation, mask))
        agent.observe(gather_decisions(streams.step(action), mask, 0.99, 0.99))
    return agent.rollout.gather()


@pytest.mark.parametrize("span", [3, 7, 100])
def test_stretches_lived_again_end_in_the_states_that_were_lived_and_episodes_begin_empty(span):
    agent = PPO(SEEN, spaces.Discrete(3), 0, PPOSettings(**SMALL | {"rollout": 10**6}))
    rollout = play(agent, TMazes(5), 40)
    starts = torch.zeros(len(rollout.place), dtype=torch.bool)
    for stream in range(5):
        rows = (rollout.stream == stream).nonzero().squeeze(1)
        starts[rows[0]] = True
        starts[rows[1:]] = rollout.over[rows[:-1]]
    assert starts.sum() > 10 and not rollout.memory[starts].any() and rollout.memory[~starts].any(dim=1).all()
    stretches = cut_stretches(rollout.stream, rollout.place, span)
    assert sorted(stretches.rows.tolist()) == list(range(200))
    assert stretches.grid.shape[0] == min(span, 40)
    with torch.no_grad():
        lived = agent._memory.read(rollout.observation, rollout.memory)
        again = agent._memory.read_stretches(rollout.observation, rollout.memory, rollout.over, stretches)
    assert again.numpy() == pytest.approx(lived[stretches.rows].numpy(), abs=1e-6)


def test_a_gradient_goes_back_to_the_start_of_a_stretch_and_not_beyond():
    agent = PPO(SEEN, spaces.Discrete(3), 0, PPOSettings(**SMALL | {"rollout": 10**6}))
    rollout = play(agent, TMazes(1), 12)
    observation = rollout.observation.clone().requires_grad_()
    stretches = cut_stretches(rollout.stream, rollout.place, 6)
    never = torch.zeros_like(rollout.over)
    seen = agent._memory.read_stretches(observation, rollout.memory, never, stretches)
    seen[stretches.rows == 9][:, 2:].sum().backward()
    assert observation.grad.abs().sum(dim=1).gt(0).tolist() == [6 <= row <= 9 for row in range(12)]


def test_many_environments_and_one_remember_the_same():
    agent = PPO(SEEN, spaces.Discrete(3), 0, PPOSettings(**SMALL | {"rollout": 10**6}))
    rollout = play(agent, TMazes(1), 15)
    one, mask, rng = PPO(SEEN, spaces.Discrete(3), 0, PPOSettings(**SMALL)), np.ones(3, bool), np.random.default_rng(0)
    for row in range(15):
        if row == 0 or rollout.over[row - 1]:
            rng = np.random.default_rng(row)  # an evaluation's next episode
        one.act_greedy(rollout.observation[row].numpy(), mask, rng)
        lived = agent._memory.read(rollout.observation[row : row + 1], rollout.memory[row : row + 1])
        assert one._memory._latest == pytest.approx(lived[0].detach().numpy(), abs=1e-6)


@pytest.mark.nightly
def test_memory_keeps_the_contract_of_agents():
    check_agent(PPO, PPOSettings(**SMALL | {"epochs": 2, "batch_size": 16}), decisions=200)


def train_mazes(seed, memory):
    settings = {"memory": memory, "memory_units": 16, "memory_span": 8, "hidden": (32,), "rollout": 512, "epochs": 4,
                "batch_size": 128, "rollout_per_env": 16, "reward_scale": 1.0, "learning_rate": 5e-3,
                "entropy_weight": 0.02}
    result = train("ppo", TMazes(64), primitives=12_000, seed=seed, settings=settings, eval_env=TMaze(),
                   eval_episodes=0)
    return evaluate(result.agent, TMaze(), 40, seed=1)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_with_a_memory_the_t_maze_is_solved_to_the_optimum(seed):
    found = train_mazes(seed, "gru")
    assert found.mean_return == pytest.approx(TMaze.BEST) and set(found.lengths) == {CORRIDOR + 1}


@pytest.mark.nightly
def test_without_one_nobody_beats_a_guess():
    assert train_mazes(0, "none").mean_return <= TMaze.FORGETFUL + 0.25


def test_states_of_objects_permute_with_the_objects():
    env = OptionsEnv(EscapeRoomEnv("four-button-chain", observation="objects"), include_primitives=False)
    settings = PPOSettings(**SMALL | {"network": "objects", "hidden": (8, 8)})
    agent = PPO(env.observation_space, env.action_space, 0, settings)
    rows, words = len(env.observation_space.rows), len(env.observation_space.words)
    rng = np.random.default_rng(0)
    life = rng.uniform(-1, 1, (3, *env.observation_space.shape)).astype(np.float32)
    life[:, : rows * words].reshape(3, rows, words)[:, :, env.observation_space.words.index("present")] = 1.0
    order = np.array([2, 0, 3, 1, 4])
    other = life.copy()
    other[:, : rows * words] = life[:, : rows * words].reshape(3, rows, words)[:, order].reshape(3, -1)
    preferences = []
    for episode in (life, other):
        rng = np.random.default_rng(0)
        for observation in episode:
            agent.act_greedy(observation, np.ones(rows, bool), rng)
        preferences.append(agent.compute_preferences(observation))
    assert preferences[1] == pytest.approx(preferences[0][order], abs=1e-5)
    agent.begin_episodes(2, torch.device("cpu"))
    assert agent.act(Moments(torch.arange(2), torch.from_numpy(life[:2]), torch.ones(2, rows, dtype=torch.bool))
                     ).shape == (2,)


def test_pictures_are_not_remembered():
    pictures = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    with pytest.raises(UnsupportedSpaceError, match="memory=gru"):
        PPO(pictures, spaces.Discrete(3), 0, PPOSettings(memory="gru"))


def test_what_is_remembered_is_part_of_a_checkpoint():
    def begin():
        return PPO(SEEN, spaces.Discrete(3), 0, PPOSettings(**SMALL | {"rollout": 10**6}))

    agent, mask, rng = begin(), np.ones(3, bool), np.random.default_rng(0)
    for observation in rng.uniform(-1, 1, (4, 2)).astype(np.float32):
        serve_one(agent).act(observation, mask)
    restored = begin()
    restored.load_state_dict(agent.state_dict())
    assert flatten(restored.state_dict()) == flatten(agent.state_dict())
    now, again = agent._recollections.now, restored._recollections.now
    assert now.any() and (again == now).all()


@pytest.mark.nightly
def test_streams_that_all_end_at_once_choose_nothing_for_a_step():
    room = dataclasses.replace(get_preset("paper-two-button"), horizon=20)
    rooms = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=4, config=room, output="torch")
    result = train("ppo", rooms, primitives=200, eval_episodes=0, progress=False, settings=SMALL)
    assert result.primitives == 200
