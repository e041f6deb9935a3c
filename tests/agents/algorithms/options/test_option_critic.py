"""Option-critic: exact values of fixed options, gradients by finite differences, Four Rooms with two slips."""

import math

import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.agent import SMDPTransition, make_transition
from hrl_escape.agents.algorithms.options.option_critic import OptionCritic, OptionCriticSettings
from tests.agents.running import interact
from tests.agents.small_envs import SmdpEnv, make_random_smdp
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import FourRooms

GAMMA = 0.9
ALL = np.ones(3, np.bool_)


def make(states=4, actions=3, **settings):
    chosen = OptionCriticSettings(**({"gamma": GAMMA, "reward_scale": 1.0, "options": 3} | settings))
    return OptionCritic(spaces.Discrete(states), spaces.Discrete(actions), 0, chosen)


def fill(agent, state, rng, scale=1.0):
    """Random tables of one state."""
    tables = agent._claim(state)
    for table in tables:
        table[...] = rng.normal(size=table.shape) * scale
    return tables


def learn(agent, option, action, reward=0.5, terminated=False, likely=None):
    """One decision of an option from state 0 to state 1; returns the change of all tables, [state][table]."""
    agent._option = option
    agent._likely = np.eye(agent.settings.options)[option] if likely is None else likely
    before = [[np.array(table) for table in agent._claim(state)] for state in (0, 1)]
    agent.observe(SMDPTransition(0, action, ALL, reward, reward, 1, GAMMA, 1, ALL, terminated, False))
    changes = [[np.array(table) - old for table, old in zip(agent._claim(state), was, strict=True)]
               for state, was in zip((0, 1), before, strict=True)]
    for state, was in zip((0, 1), before, strict=True):
        for table, old in zip(agent._claim(state), was, strict=True):
            table[...] = old
    return changes


VALUES, ACTION_VALUES, PREFERENCES, ENDINGS = range(4)


def softmax(numbers):
    weights = np.exp(numbers - numbers.max())
    return weights / weights.sum()


# --- critic -------------------------------------------------------------------------------


@pytest.mark.nightly_for("0.4")
@pytest.mark.parametrize("cost", [0.0, 0.4])
def test_values_of_fixed_options_are_exact_for_decisions_of_any_duration(cost):
    """Deterministic policies in a deterministic SMDP, random terminations: a fixed point, iterated apart."""
    smdp = make_random_smdp(3, branches=1)
    env = SmdpEnv(smdp)
    states, rng, epsilon = len(smdp), np.random.default_rng(1), 0.3
    masks = [env.compute_mask(state) != 0 for state in range(states)]
    agent = OptionCritic(env.observation_space, env.action_space, 0, OptionCriticSettings(
        gamma=GAMMA, options=3, critic_rate=1.0, policy_rate=0.0, termination_rate=0.0, reward_scale=0.5,
        epsilon=epsilon, deliberation_cost=cost))  # fmt: skip
    chosen = np.array([[rng.choice(np.flatnonzero(mask)) for _ in range(3)] for mask in masks])
    for state in range(states):
        tables = agent._claim(state)
        tables.preferences[np.arange(3), chosen[state]] = 100.0
        tables.endings[:] = rng.normal(size=3)
    beta = np.array([agent.compute_terminations(state) for state in range(states)])

    exact = np.zeros((states, 3))
    for _ in range(300):
        mean = (1 - epsilon) * exact.max(axis=1) + epsilon * exact.mean(axis=1)
        arrival = (1 - beta) * exact + beta * (mean - cost / 0.5)[:, None]
        for state in range(states):
            for option in range(3):
                (outcome,) = smdp[state][chosen[state, option]]
                earned = sum(GAMMA**i * reward for i, reward in enumerate(outcome.rewards))
                left = 0.0 if outcome.terminated else GAMMA ** len(outcome.rewards)
                exact[state, option] = earned + left * arrival[outcome.next_state, option]

    for _ in range(150):
        for state in range(states):
            for option in range(3):
                action = int(chosen[state, option])
                env.reset()
                env.state, agent._option = state, option
                agent.observe(make_transition(state, action, masks[state], env.step(action), GAMMA))
    for state in range(states):
        assert agent.compute_option_values(state) == pytest.approx(exact[state], abs=1e-9)
        best = exact[state].argmax()
        assert agent.compute_values(state)[chosen[state, best]] == pytest.approx(exact[state, best], abs=1e-9)
        expected = (1 - epsilon) * exact[state].max() + epsilon * exact[state].mean()
        assert agent.compute_state_value(state) == pytest.approx(expected, abs=1e-9)


# --- gradients ----------------------------------------------------------------------------


def test_the_policy_climbs_the_value_of_the_option_that_ran():
    """In expectation over its actions, against a finite difference of sum over a of pi(a) Q_U(a)."""
    agent = make(critic_rate=1e-12, policy_rate=0.5, temperature=0.7)
    rng = np.random.default_rng(0)
    tables = fill(agent, 0, rng)
    fill(agent, 1, rng)
    for option in range(3):
        policy = softmax(tables.preferences[option] / 0.7)
        changes = [learn(agent, option, action)[0][PREFERENCES] for action in range(3)]
        expected = sum(policy[action] * changes[action] for action in range(3))
        assert not np.delete(expected, option, axis=0).any(), "no other option is touched"

        def value(theta, option=option):
            return softmax(theta / 0.7) @ tables.action_values[option]

        theta, step = tables.preferences[option], 1e-5
        slope = [(value(theta + step * e) - value(theta - step * e)) / (2 * step) for e in np.eye(3)]
        assert expected[option] == pytest.approx(0.5 * 0.7 * np.array(slope), abs=1e-8)


@pytest.mark.parametrize("cost", [0.0, 0.3])
def test_termination_climbs_the_value_upon_arrival_at_the_state_reached_for_the_option_that_ran(cost):
    agent = make(critic_rate=1e-12, termination_rate=0.5, deliberation_cost=cost, epsilon=0.2)
    rng = np.random.default_rng(2)
    fill(agent, 0, rng)
    there = fill(agent, 1, rng)
    mean = 0.8 * there.values.max() + 0.2 * there.values.mean()
    signs = set()
    for option in range(3):
        here_change, there_change = learn(agent, option, 1)
        assert not here_change[ENDINGS].any()
        assert not np.delete(there_change[ENDINGS], option).any()

        def value(phi, option=option):
            beta = 1 / (1 + math.exp(-phi))
            return (1 - beta) * there.values[option] + beta * (mean - cost)

        phi, step = there.endings[option], 1e-5
        slope = (value(phi + step) - value(phi - step)) / (2 * step)
        assert there_change[ENDINGS][option] == pytest.approx(0.5 * slope, abs=1e-8)
        signs.add(np.sign(slope))
    assert signs == {-1, 1}, "the best option is ended less often, the worst more often"


def test_the_best_option_is_worth_more_than_the_mean_choice_so_that_its_termination_can_fall():
    agent = make(critic_rate=1e-12, epsilon=0.2, options=2)
    agent._claim(1).values[:] = 1.0, 0.0
    assert learn(agent, 0, 0)[1][ENDINGS][0] == pytest.approx(-0.25 * 0.25 * 0.1)
    assert learn(agent, 1, 0)[1][ENDINGS][1] == pytest.approx(0.25 * 0.25 * 0.9)


def test_a_margin_makes_ending_rarer_and_is_paid_nowhere():
    plain, wide = make(critic_rate=0.5), make(critic_rate=0.5, termination_margin=0.3)
    without, with_margin = learn(plain, 0, 0), learn(wide, 0, 0)
    assert (without[0][VALUES] == with_margin[0][VALUES]).all()
    assert with_margin[1][ENDINGS][0] == pytest.approx(without[1][ENDINGS][0] - 0.25 * 0.25 * 0.3)


def test_nothing_is_learned_of_termination_where_the_task_ended():
    agent = make()
    fill(agent, 1, np.random.default_rng(0))
    here, there = learn(agent, 0, 0, terminated=True)
    assert not there[ENDINGS].any()
    assert here[VALUES][0] == pytest.approx(0.5 * 0.5)


def test_an_episode_s_first_state_teaches_no_termination():
    agent = make()
    fill(agent, 0, np.random.default_rng(0))
    endings = agent.compute_terminations(0)
    agent.act(0, ALL)
    agent.observe(SMDPTransition(0, 0, ALL, 1.0, 1.0, 1, GAMMA, 1, ALL, False, False))
    assert (agent.compute_terminations(0) == endings).all()


# --- several options at once --------------------------------------------------------------


def test_updating_every_option_is_in_expectation_updating_the_one_that_runs():
    """Over options drawn by P(o | s, the option before) and actions of theirs: values, policies, terminations."""
    likely = np.array([0.5, 0.3, 0.2])
    rng = np.random.default_rng(4)
    one, several = make(critic_rate=0.01), make(critic_rate=0.01, multi_option=1.0)
    for agent in (one, several):
        rng = np.random.default_rng(4)
        for state in (0, 1):
            fill(agent, state, rng, 0.3)
            agent._claim(state).preferences[...] *= 0.001  # ratios near 1, so that none is cut off
        agent._claim(0).action_values[...] = 0.0
    expected = []
    for agent in (one, several):
        policies = agent.compute_policies(0, ALL)
        total = [[0.0] * 4, [0.0] * 4]
        for option in range(3):
            for action in range(3):
                changes = learn(agent, option, action, likely=likely)
                for state in (0, 1):
                    for table in range(4):
                        total[state][table] += likely[option] * policies[option, action] * changes[state][table]
        expected.append(total)
    for state, table in ((0, VALUES), (1, ENDINGS)):
        assert expected[1][state][table] == pytest.approx(expected[0][state][table], abs=1e-12)
        assert np.abs(expected[0][state][table]).min() > 0
    single, many = (learn(agent, 0, 0, likely=likely)[0][VALUES] for agent in (one, several))
    assert (single != 0).sum() == 1 and (many != 0).all()


def test_an_option_that_does_not_run_learns_by_how_much_likelier_it_would_have_acted_so_at_most_once():
    """Weights 0.5 each; the other option takes the action 27 times, or 1/27 times, as often as the one that runs."""
    agent, likely = make(options=2, critic_rate=0.5, multi_option=1.0), np.array([0.5, 0.5])
    tables = agent._claim(0)
    tables.preferences[0, 0] = math.log(27.0)
    policies = agent.compute_policies(0, ALL)
    for option, other in ((0, 1), (1, 0)):
        ratio = policies[other, 0] / policies[option, 0]
        change = learn(agent, option, 0, terminated=True, likely=likely)[0][VALUES]
        assert change[option] == pytest.approx(0.5 * 0.5 * 0.5)
        assert change[other] == pytest.approx(0.5 * min(0.5 * ratio, 1.0) * 0.5)
        assert (ratio > 2) == (option == 1), "cut off, or not"


def test_the_policy_of_every_option_moves_by_its_own_advantage():
    likely = np.array([0.5, 0.3, 0.2])
    agent = make(critic_rate=1e-12, multi_option=1.0, policy_rate=0.5)
    rng = np.random.default_rng(4)
    for state in (0, 1):
        fill(agent, state, rng)
    tables = agent._claim(0)
    tables.preferences[...] *= 0.001
    policies = agent.compute_policies(0, ALL)
    total = np.zeros((3, 3))
    for option in range(3):
        for action in range(3):
            change = learn(agent, option, action, likely=likely)[0][PREFERENCES]
            total += likely[option] * policies[option, action] * change
    for option in range(3):
        advantage = tables.action_values[option] - tables.values[option]
        slope = policies[option] * (advantage - policies[option] @ advantage)
        assert total[option] == pytest.approx(0.5 * likely[option] * slope, abs=1e-9)


def test_the_weight_of_an_option_is_the_chance_that_it_runs_given_the_one_before():
    agent = make(options=2, epsilon=0.2, termination_rate=0.0, critic_rate=1e-12)
    agent._claim(1).values[:] = 1.0, 0.0
    agent._claim(1).endings[:] = math.log(0.25 / 0.75)
    agent.act(0, ALL)
    agent._option = 1
    agent.observe(SMDPTransition(0, 0, ALL, 0.0, 0.0, 1, GAMMA, 1, ALL, False, False))
    assert agent._likely == pytest.approx([0.25 * 0.9, 0.75 + 0.25 * 0.1])


# --- acting -------------------------------------------------------------------------------


def test_in_evaluation_an_option_runs_until_it_ends():
    agent = make(options=2, temperature=0.01)
    for state in (0, 1):
        tables = agent._claim(state)
        tables.values[:] = (1.0, 0.0) if state == 0 else (0.0, 1.0)
        tables.preferences[0, 0] = tables.preferences[1, 1] = 1.0
        tables.endings[:] = -50.0
    rng = np.random.default_rng(0)
    assert [agent.act_greedy(state, ALL, rng) for state in (0, 1, 1)] == [0, 0, 0]
    (call,) = agent.list_calls()
    assert (call.task, call.primitives) == ("option-0", 2)
    assert agent.act_greedy(1, ALL, np.random.default_rng(0)) == 1, "another episode begins with the best"
    agent._claim(1).endings[:] = 50.0
    rng = np.random.default_rng(0)
    assert [agent.act_greedy(state, ALL, rng) for state in (0, 1)] == [0, 1]


# --- Four Rooms ---------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.nightly_for("extra")
@pytest.mark.filterwarnings("ignore:.*collapsed")
@pytest.mark.parametrize("slip", ["extra", "neighbour"])
def test_four_rooms_are_walked_nearly_as_fast_as_can_be(slip):
    """The benchmark of twenty seeds is `python -m benchmarks.option_critic`."""
    env = FourRooms(62, slip)
    tables = env.make_tables()
    floor = find_fewest_primitives(tables) @ tables.starts
    agent = OptionCritic(env.observation_space, env.action_space, 1, OptionCriticSettings(reward_scale=1.0))
    ends = [n for n, step in enumerate(interact(agent, env, 9_000, seed=1)) if step.terminated or step.truncated]
    late = np.diff(ends)[-100:]
    assert floor < late.mean() < 2 * floor
    beta = np.array([agent.compute_terminations(state) for state in range(104)])
    assert (beta > 0.5).any() and (beta < 0.5).any(), "terminations differ by state"
    assert 1.1 < agent.log.compute_duration() < 10
