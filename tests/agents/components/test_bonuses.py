"""Count bonuses: what a visit is worth, what agents learn from it, and what it never touches."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import make_agent, train
from hrl_escape.agents.components.bonuses import CountBonus
from hrl_escape.errors import UnsupportedSpaceError
from tests.agents.running import interact
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv

ROOM = gymnasium.spaces.Box(np.array([-1, -1, 0], np.float32), np.array([1, 1, 1], np.float32))


def test_the_nth_visit_of_a_cell_is_worth_weight_over_root_n_less_the_weight():
    bonus = CountBonus(ROOM, 6.0, 3, "dqn")
    worth = [bonus.visit(np.array([x, 0.0, 0.0])) for x in (0.0, 0.2, -0.3, 0.0)]
    assert worth == pytest.approx([0, 6 / 2**0.5 - 6, 6 / 3**0.5 - 6, -3])
    assert bonus.visit(np.array([0.0, 0.0, 1.0])) == 0, "a puzzle bit makes another cell"
    assert bonus.state_dict()["counts"].tolist() == [4, 1]


def test_a_weight_of_0_counts_nothing_and_takes_any_space():
    pictures = gymnasium.spaces.Box(0, 255, (84, 84, 3), np.uint8)
    bonus = CountBonus(pictures, 0.0, 5, "dqn")
    assert bonus.visit(pictures.sample()) == 0.0 and not len(bonus.state_dict()["counts"])
    with pytest.raises(UnsupportedSpaceError, match="dqn"):
        CountBonus(pictures, 1.0, 5, "dqn")


def test_the_bonus_is_learned_from_and_stays_out_of_returns():
    def make_env() -> SmdpEnv:
        return SmdpEnv([[[Outcome(1.0, 0, (-1.0,), True)]]])  # one state, one action, the end

    agent = make_agent("q-learning", make_env().observation_space, make_env().action_space, 0, bonus_weight=5.0,
                       learning_rate=1.0)
    values = [agent.compute_values(t.observation)[0] for t in interact(agent, make_env(), 4)]  # type: ignore[attr-defined]
    assert values == pytest.approx([-6 + 5 / n**0.5 for n in (1, 2, 3, 4)])
    result = train("q-learning", make_env(), primitives=4, settings={"bonus_weight": 5.0}, eval_episodes=1)
    assert {record.episode_return for record in result.episodes} == {-1.0}


@pytest.mark.parametrize("name", ["dqn", "ppo"])
def test_deep_agents_learn_from_the_bonus(name: str):
    def find_rewards(weight: float) -> list[float]:
        env = ButtonGrid(with_options=False)
        single = {"n_step": 1} if name == "dqn" else {}
        agent = make_agent(name, env.observation_space, env.action_space, 0, bonus_weight=weight, **single)
        for _ in interact(agent, env, 5):
            pass
        rows = agent.replay._fields.reward[:5] if name == "dqn" else agent.rollout.gather().reward  # type: ignore[attr-defined]
        return [float(row) / agent.settings.reward_scale for row in rows]

    plain, counted = find_rewards(0.0), find_rewards(8.0)
    assert counted[0] == pytest.approx(plain[0])
    assert sum(counted) < sum(plain) - 1


@pytest.mark.nightly
def test_counts_find_the_end_of_a_corridor_without_rewards_that_chance_does_not():
    states = 30
    corridor = [
        [[Outcome(1.0, max(state - 1, 0), (0.0,))], [Outcome(1.0, state + 1, (0.0,), state + 1 == states)]]
        for state in range(states)
    ]
    corridor.append([[Outcome(1.0, 0, (0.0,), True)]] * 2)

    def count_ends(weight: float) -> int:
        settings = {"bonus_weight": weight, "epsilon_start": 0.1, "epsilon_end": 0.1}
        result = train("q-learning", SmdpEnv(corridor, horizon=60), primitives=3_000, settings=settings,
                       eval_episodes=0)
        return sum(record.end == "terminated" for record in result.episodes)

    assert count_ends(0.0) == 0 < 10 < count_ends(1.0)
