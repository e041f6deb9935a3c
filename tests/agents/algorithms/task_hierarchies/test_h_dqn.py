"""h-DQN: backups at both levels worked out by hand, and the chain of six states with its exact optimum."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.algorithms.task_hierarchies.h_dqn import HDqn
from hrl_escape.agents.hierarchy.goal_space import GoalSet
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.checks import check_agent
from hrl_escape.errors import AgentSettingsError
from tests.agents.running import interact, learn
from tests.agents.small_envs import Outcome, SmdpEnv
from tests.classic.chain import LENGTH, Chain
from tests.classic.exact import evaluate, find_values, make_model

BOTH = np.ones(2, np.bool_)
TABLE = {"values": "table", "worker_warmup": 0, "patience": 0}


def make(env, agent_class=HDqn, seed=0, **settings):
    return agent_class(env.observation_space, env.action_space, seed, HDqn.Settings(**TABLE | settings))


class StoresTheLastState(HDqn):
    """The manager's backup begins where the call ended, as where `state` is overwritten in the inner loop."""

    def learn(self, step, returns):
        last = [
            each._replace(stack=(*each.stack[:-1], _move(each.frame, step.seen.observation))) for each in returns
        ]
        return super().learn(step, last)


def _move(frame, observation):
    return frame._replace(decision=frame.decision._replace(view=observation))


def walk_to_goal_three(agent):
    """Positions 1, 2, 3 in the chain under goal 3, each step paid 2."""
    choices = iter([3, 1, 1])
    agent.choose = lambda stack, view, legal, seen: next(choices)
    for position in (1, 2):
        assert agent.act(position, BOTH) == 1
        agent.observe(make_transition(position, 1, BOTH, (position + 1, 2.0, False, False, {}), agent.gamma))


@pytest.mark.parametrize(("agent_class", "start"), [(HDqn, 1), (StoresTheLastState, 2)])
def test_the_manager_learns_in_the_state_where_the_goal_was_named(agent_class, start):
    agent = make(Chain(), agent_class, gamma=0.9, table_learning_rate=1.0)
    agent.manager.update(agent.manager._make_key(3, None), 5, 10.0)
    agent.worker.update(agent.worker._make_key(3, 3), 1, 50.0)
    walk_to_goal_three(agent)
    expected = 2 + 0.9 * 2 + 0.81 * 10
    assert agent.manager.compute(start, None)[3] == pytest.approx(expected)
    assert agent.manager.compute(3 - start, None)[3] == 0
    assert agent.worker.compute(2, 3)[1] == 1.0, "nothing after the goal"
    assert agent.worker.compute(1, 3)[1] == 0.0


def test_a_goal_given_up_bootstraps_at_both_levels():
    agent = make(Chain(), gamma=0.9, table_learning_rate=1.0, patience=1)
    agent.worker.update(agent.worker._make_key(2, 4), 0, 0.5)
    agent.manager.update(agent.manager._make_key(2, None), 5, 10.0)
    choices = iter([4, 1])
    agent.choose = lambda stack, view, legal, seen: next(choices)
    agent.act(1, BOTH)
    agent.observe(make_transition(1, 1, BOTH, (2, 3.0, False, False, {}), 0.9))
    assert agent.worker.compute(1, 4)[1] == pytest.approx(0.45)
    assert agent.manager.compute(1, None)[4] == pytest.approx(3 + 9)
    assert agent.successes[4] == 0


def compute_value(env, agent, gamma=1.0):
    """Exact value of the greedy hierarchical policy at the start, by rows (state, goal)."""
    states, goals = env.states, env.states
    tables = env.make_tables()
    count = states * goals
    rewards, follow = np.zeros(count), np.zeros((count, count))

    def name(state):
        legal = np.arange(goals) != state
        return int(np.where(legal, agent.manager.compute(state, None), -np.inf).argmax())

    for state in range(states):
        for goal in range(goals):
            row = state * goals + goal
            action = int(agent.worker.compute(state, goal).argmax())
            rewards[row] = tables.rewards[state, action]
            for after in np.flatnonzero(tables.continuing[state, action]):
                following = name(after) if after == goal else goal
                follow[row, after * goals + following] += gamma * tables.continuing[state, action, after]
    values = np.linalg.solve(np.eye(count) - follow, rewards)
    return values[1 * goals + name(1)]


def train_on_chain(seed, primitives=30_000):
    env = Chain()
    agent = make(env, seed=seed, gamma=1.0, table_learning_rate=1.0, table_learning_rate_power=0.7,
                 epsilon_end=0.3, epsilon_steps=20_000, worker_epsilon_end=0.2)  # fmt: skip
    learn(agent, env, primitives, seed)
    return compute_value(env, agent)


@pytest.mark.slow
def test_the_chain_is_solved_to_its_exact_optimum_where_the_visit_is_seen():
    env = Chain()
    model = make_model(env.make_tables(), 1.0)
    optimum = find_values(model)[1]
    chance = evaluate(model, np.full((2 * LENGTH, 2), 0.5))[1]
    assert (round(optimum, 5), round(chance, 5)) == (0.208, 0.01818)
    values = [train_on_chain(seed) for seed in range(3)]
    assert np.median(values) == pytest.approx(optimum, abs=1e-9), values
    assert min(values) > 5 * chance, values


@pytest.mark.nightly
def test_tuned_q_learning_solves_the_chain_too_if_it_sees_the_visit():
    """The published gap is one of exploration and of what is seen, not of what can be represented."""
    env = Chain()
    settings = QLearning.Settings(
        gamma=1.0, learning_rate=1.0, learning_rate_power=0.7, epsilon_end=0.3, epsilon_steps=10_000
    )
    agent = QLearning(env.observation_space, env.action_space, 0, settings)
    learn(agent, env, 30_000)
    policy = np.eye(2)[[int(agent.compute_values(state).argmax()) for state in range(env.states)]]
    assert evaluate(make_model(env.make_tables(), 1.0), policy)[1] == pytest.approx(0.208, abs=1e-9)


def test_patience_is_counted_in_primitives_in_evaluation_as_in_training():
    """Every action takes two primitives, so that a goal is given up after two decisions of four primitives."""
    smdp = tuple(((Outcome(1.0, (state + 1) % 9, (-1.0, -1.0)),),) for state in range(9))
    env = SmdpEnv(smdp, horizon=18)
    agent = make(env, patience=4)
    trained = {agent.list_calls()[1].primitives for _ in interact(agent, env, 90)}
    played = {agent.list_calls()[1].primitives for seed in range(10) for _ in play_episode(agent, env, seed)}
    assert played == trained == {0, 2}


@pytest.mark.nightly_for("network")
@pytest.mark.parametrize("values", ["table", "network"])
def test_it_keeps_the_contract_of_agents(values):
    small = {"hidden": (8,), "batch_size": 8, "worker_warmup": 20, "patience": 7}
    check_agent(HDqn, HDqn.Settings(values=values, **small), decisions=200)


def test_a_replay_of_one_decision_is_the_smallest():
    assert HDqn.Settings(replay_capacity=1).replay_capacity == 1
    with pytest.raises(AgentSettingsError, match="replay_capacity = 0"):
        HDqn.Settings(replay_capacity=0)


def test_goals_that_are_given_are_a_privilege():
    env = Chain()
    goals = GoalSet(1, lambda observation, goal: observation == 5)
    agent = HDqn(env.observation_space, env.action_space, 0, HDqn.Settings(**TABLE), goals)
    assert agent.privileges == ("goals",) and make(env).privileges == ()


@pytest.mark.slow
def test_networks_value_the_way_to_a_goal_near_its_probability():
    """Goal 11 is the last position: right all the way, reached from position p with probability p / 5."""
    env = Chain()
    settings = HDqn.Settings(gamma=1.0, hidden=(32,), worker_warmup=10_000, patience=0, reward_scale=1.0,
                             learning_rate=2e-3, target_rate=0.02, worker_epsilon_end=0.2)  # fmt: skip
    agent = HDqn(env.observation_space, env.action_space, 0, settings)
    learn(agent, env, 5_000)
    values = np.array([agent.worker.compute(position, 11) for position in range(1, 5)])
    assert (values.argmax(axis=1) == 1).all()
    assert values.max(axis=1) == pytest.approx([0.2, 0.4, 0.6, 0.8], abs=0.2)
