"""Random network distillation: novelty is dear to find, never paid for twice, and never a reason to stay."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import make_agent
from hrl_escape.agents.algorithms.dqn import DQNSettings
from hrl_escape.agents.components.bonuses import CountBonus
from hrl_escape.agents.components.distillation import DistillationBonus, make_bonus
from tests.agents.running import interact, learn
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv

ROOM = gymnasium.spaces.Box(np.array([-1, -1, 0], np.float32), np.array([1, 1, 1], np.float32))
NETWORKS = DQNSettings(learning_rate=1e-3)


def make_familiar(visits: int = 2_000, seed: int = 0) -> tuple[DistillationBonus, list[float]]:
    """A bonus that has seen the room's western half with its bit off, and what each visit gave."""
    bonus, rng = DistillationBonus(ROOM, seed, 6.0, NETWORKS, "dqn"), np.random.default_rng(0)
    return bonus, [bonus.visit(np.array([rng.uniform(-1, 0), rng.uniform(-1, 1), 0.0])) for _ in range(visits)]


def test_familiar_observations_cost_the_weight_and_new_ones_nothing():
    bonus, worth = make_familiar()
    assert worth[0] == 0
    assert -6 <= np.mean(worth[-200:]) < -4
    state = deepcopy(bonus.state_dict())
    for new in ([-0.5, 0.0, 1.0], [0.9, 0.9, 0.0]):
        assert bonus.visit(np.array(new)) == 0, "another bit, or the other half"
        bonus.load_state_dict(state)


def test_no_visit_is_ever_paid_for_so_that_none_puts_off_the_end():
    assert max(make_familiar(500)[1]) <= 0


def test_observations_are_whitened_before_they_are_compared():
    scale = np.array([1.0, 1e3, 1e-3], np.float32)
    wide = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    rng, plain, scaled = np.random.default_rng(0), [], []
    bonuses = [DistillationBonus(wide, 0, 1.0, NETWORKS, "dqn") for _ in range(2)]
    for _ in range(300):
        observation = rng.standard_normal(3)
        plain.append(bonuses[0].visit(observation))
        scaled.append(bonuses[1].visit(observation * scale))
    assert scaled == pytest.approx(plain, abs=0.02)


def test_a_restored_bonus_goes_on_to_the_last_bit():
    bonus, _ = make_familiar(100)
    restored = DistillationBonus(ROOM, 1, 6.0, NETWORKS, "dqn")
    restored.load_state_dict(deepcopy(bonus.state_dict()))
    rng = np.random.default_rng(1)
    later = [rng.uniform(-1, 1, 3) for _ in range(80)]
    assert [restored.visit(each) for each in later] == [bonus.visit(each) for each in later]


@pytest.mark.nightly
def test_pictures_have_novelty_where_counts_have_no_cells():
    pictures = gymnasium.spaces.Box(0, 255, (36, 36, 1), np.uint8)
    settings = DQNSettings(bonus_weight=1.0, bonus="distillation", learning_rate=1e-3)
    bonus = make_bonus(pictures, 0, settings, "dqn")
    black, white = np.zeros((36, 36, 1), np.uint8), np.full((36, 36, 1), 255, np.uint8)
    familiar = [bonus.visit(black) for _ in range(640)][-1]
    assert familiar < -0.5 < bonus.visit(white) == 0


def test_a_weight_of_0_distils_nothing():
    bonus = make_bonus(ROOM, 0, DQNSettings(bonus="distillation"), "dqn")
    assert isinstance(bonus, CountBonus) and bonus.visit(np.zeros(3)) == 0


@pytest.mark.parametrize("name", ["dqn", "ppo"])
def test_deep_agents_learn_from_distillation_and_act_as_before_until_they_do(name: str):
    def find_rewards(**settings: Any) -> tuple[list[int], list[float]]:
        env = ButtonGrid(with_options=False)
        single = {"n_step": 1} if name == "dqn" else {}
        agent = make_agent(name, env.observation_space, env.action_space, 0, **settings, **single)
        actions = [transition.action for transition in interact(agent, env, 60)]
        rows = agent.replay._fields.reward[:60] if name == "dqn" else agent.rollout.gather().reward  # type: ignore[attr-defined]
        return actions, [float(row) / agent.settings.reward_scale for row in rows]

    actions, plain = find_rewards()
    same_actions, distilled = find_rewards(bonus="distillation", bonus_weight=8.0)
    assert same_actions == actions
    assert distilled[0] == pytest.approx(plain[0])
    assert sum(distilled) < sum(plain) - 8


@pytest.mark.parametrize("name", ["dqn", "ppo"])
def test_an_agent_with_distillation_resumes_to_the_last_bit(name: str):
    env = ButtonGrid(with_options=False)
    agents = [
        make_agent(name, env.observation_space, env.action_space, seed, bonus="distillation", bonus_weight=2.0)
        for seed in (0, 1)
    ]
    learn(agents[0], env, 50)
    agents[1].load_state_dict(deepcopy(agents[0].state_dict()))
    runs = [[t.action for t in interact(agent, ButtonGrid(with_options=False), 50)] for agent in agents]
    assert runs[0] == runs[1]


@pytest.mark.nightly
def test_distillation_finds_the_end_of_a_corridor_without_rewards_that_chance_does_not():
    states = 24

    def make_row(state: int) -> list[list[Outcome]]:
        back = [Outcome(1.0, max(state - 1, 0), (0.0,))]
        on = [Outcome(1.0, state + 1, (0.0,), state + 1 == states)]
        return [on, back] if state % 3 else [back, on]  # so that no one action leads to the end

    corridor = [make_row(state) for state in range(states)]
    corridor.append([[Outcome(1.0, 0, (0.0,), True)]] * 2)

    def count_ends(weight: float) -> int:
        env = SmdpEnv(corridor, horizon=60, one_hot=True)
        agent = make_agent("ppo", env.observation_space, env.action_space, 0, bonus="distillation",
                           bonus_weight=weight, gamma=0.95)
        return sum(transition.terminated for transition in interact(agent, env, 2_000))

    assert count_ends(0.0) == 0 < count_ends(5.0)
