"""Tabular agents reach exact values: of SMDPs solved by linear algebra, and of Gymnasium's Taxi."""

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition, read_action_mask
from hrl_escape.agents.algorithms.intra_option_q import IntraOptionQ, IntraOptionQSettings
from hrl_escape.agents.algorithms.q_learning import QLearning, QLearningSettings
from hrl_escape.agents.components.exploration import choose_best
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.errors import StepContractError, UnsupportedSpaceError
from tests.agents.running import learn
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv, Step, make_random_smdp, solve

EXPLORE = {"epsilon_start": 1.0, "epsilon_end": 1.0}


def make_q_learning(env, **settings):
    return QLearning(env.observation_space, env.action_space, 0, QLearningSettings(**(EXPLORE | settings)))


def learn_from_everywhere(agent, env, decisions):
    """Episodes of 40 decisions from random states, never cut inside an action."""
    for episode in range(decisions // 40):
        learn(agent, env, 40, seed=episode)


def read_table(agent, env):
    """Q over all states, -inf where illegal."""
    rows = [agent.compute_values(env.observe(state)) for state in range(len(env.smdp))]
    masks = [env.compute_mask(state) != 0 for state in range(len(env.smdp))]
    return np.where(masks, rows, -np.inf)


def assert_equal_tables(table, exact, tolerance):
    assert (np.isneginf(table) == np.isneginf(exact)).all()
    legal = np.isfinite(exact)
    assert table[legal] == pytest.approx(exact[legal], abs=tolerance)


@pytest.mark.nightly_for(
    "0-True-IntraOptionQ", "1-True-IntraOptionQ", "2-True-IntraOptionQ", "0-False-IntraOptionQ", "0-True-QLearning",
    "1-False-IntraOptionQ", "1-True-QLearning", "2-True-QLearning", "2-False-QLearning", "1-False-QLearning",
    "2-False-IntraOptionQ")
@pytest.mark.parametrize("agent_class", [QLearning, IntraOptionQ])
@pytest.mark.parametrize("one_hot", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_deterministic_smdps_are_solved_exactly(agent_class, one_hot, seed):
    smdp = make_random_smdp(seed, branches=1)
    env = SmdpEnv(smdp, start=None, one_hot=one_hot)
    if agent_class is IntraOptionQ:
        env = GiveTrace(env)
    settings = agent_class.Settings(gamma=0.9, learning_rate=1.0, **EXPLORE)
    agent = agent_class(env.observation_space, env.action_space, 0, settings)
    learn_from_everywhere(agent, env, 8_000)
    assert_equal_tables(read_table(agent, env.unwrapped), solve(smdp, 0.9), 1e-9)


class GiveTrace(gymnasium.Wrapper):
    """Adds traces in which only primitives are consistent, as of options that are no function of the state."""

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["trace"] = [Step(None, -1, r, None) for r in info["rewards"]]
        return observation, reward, terminated, truncated, info


@pytest.mark.nightly
def test_stochastic_smdps_are_solved_in_the_limit():
    smdp = make_random_smdp(5, states=4, actions=3)
    env = SmdpEnv(smdp, start=None)
    agent = make_q_learning(env, gamma=0.9, learning_rate=1.0, learning_rate_power=0.85)
    learn_from_everywhere(agent, env, 60_000)
    assert_equal_tables(read_table(agent, env), solve(smdp, 0.9), 0.25)


TO_THE_EXIT = (-1.0,) * 15 + (99.0,)


def test_trap_1_an_option_learned_from_its_primitive_rewards_is_worth_their_discounted_sum():
    smdp = ((((Outcome(1.0, 0, (-1.0,) * 16, True)),),),)
    agent = make_q_learning(env := SmdpEnv(smdp), gamma=0.9, learning_rate=1.0)
    learn(agent, env, 1)
    assert agent.compute_values(0)[0] == pytest.approx(-(1 - 0.9**16) / 0.1, abs=1e-12)


@pytest.mark.parametrize("cuts", [(), (8,), (3, 9), tuple(range(1, 16))])
def test_trap_2_cutting_an_option_into_parts_does_not_change_values(cuts):
    borders = (0, *cuts, 16)
    parts = [TO_THE_EXIT[a:b] for a, b in zip(borders, borders[1:], strict=False)]
    smdp = tuple(((Outcome(1.0, i + 1, part, i == len(parts) - 1),),) for i, part in enumerate(parts))
    smdp = (*smdp, ((Outcome(1.0, 0, (0.0,), True),),))
    agent = make_q_learning(env := SmdpEnv(smdp), gamma=0.9, learning_rate=1.0)
    learn(agent, env, 500)
    assert agent.compute_values(0)[0] == pytest.approx(sum(0.9**i * r for i, r in enumerate(TO_THE_EXIT)), abs=1e-9)


def test_trap_3_a_cap_inside_an_option_bootstraps_from_where_it_was_cut():
    option = (Outcome(1.0, 1, (-1.0,) * 16),)
    primitive = (Outcome(1.0, 1, (-2.0,), True),)
    env = SmdpEnv(((option, primitive), (option, primitive)), horizon=5)  # a cut option stays in its state
    agent = make_q_learning(env, gamma=0.9, learning_rate=1.0)
    agent.table.update(agent._discretise(0), 1, 40.0)
    mask = np.ones(2, np.bool_)
    env.reset(seed=0)
    transition = make_transition(0, 0, mask, env.step(0), 0.9)
    agent.observe(transition)
    assert (transition.duration, transition.truncated, transition.terminated) == (5, True, False)
    assert agent.compute_values(0)[0] == pytest.approx(-(1 - 0.9**5) / 0.1 + 0.9**5 * 40.0, abs=1e-12)


def test_trap_9_an_illegal_action_of_high_value_does_not_win_the_maximum():
    smdp = (((Outcome(1.0, 1, (-1.0,)),), ()), ((Outcome(1.0, 1, (5.0,), True),), ()))
    env = SmdpEnv(smdp)
    agent = make_q_learning(env, gamma=0.9, learning_rate=1.0)
    for state in (0, 1):
        agent.table.update(agent._discretise(state), 1, 1e6)
    learn(agent, env, 100)
    assert agent.compute_values(0)[0] == pytest.approx(-1 + 0.9 * 5, abs=1e-12)
    assert agent.act_greedy(0, np.array([True, False]), np.random.default_rng(0)) == 0


@pytest.mark.nightly
def test_ties_are_drawn_so_that_a_goal_is_found_where_steps_cost_nothing():
    """FrozenLake without slip pays at the goal alone; the lowest number among equals would never leave the start."""
    env = gymnasium.make("FrozenLake-v1", is_slippery=False)
    for seed in range(4):
        agent = QLearning(env.observation_space, env.action_space, seed, QLearningSettings())
        assert {agent.act_greedy(0, np.ones(4, np.bool_), np.random.default_rng(n)) for n in range(40)} == set(range(4))
        learn(agent, env, 10_000, seed)
        first, again = (evaluate(agent, env, 2, seed=3) for _ in range(2))
        assert first.mean_return == 1.0 and first == again


# --- intra-option learning ----------------------------------------------------------------


def make_intra(env, **settings):
    chosen = IntraOptionQSettings(**({"gamma": 0.9, "learning_rate": 1.0} | EXPLORE | settings))
    return IntraOptionQ(env.observation_space, env.action_space, 0, chosen)


def show(agent, action, trace, **fields):
    """One decision with this trace, told to the agent."""
    info = {"duration": len(trace), "rewards": [step.reward for step in trace], "trace": trace} | fields
    mask = np.ones(int(agent.table._actions), np.bool_)
    step = (trace[-1].next_observation, sum(info["rewards"]), fields.get("terminated", False), False, info)
    agent.observe(make_transition(trace[0].observation, action, mask, step, agent.gamma))


ALL = np.ones(3, np.int8)


def test_one_run_of_an_option_teaches_all_options_and_primitives_consistent_with_it():
    agent = make_intra(env := SmdpEnv(make_random_smdp(0, states=4, actions=3)))
    # Option 1 runs from 0 over 1 to 2; option 2 would have gone the same way and further; 0 is the primitive.
    trace = [
        Step(0, 0, -1.0, 1, ALL, ((0, 1.0), (1, 0.0), (2, 0.0))),
        Step(1, 0, 7.0, 2, ALL, ((0, 1.0), (1, 1.0), (2, 0.0))),
    ]
    agent.table.update(agent._discretise(2), 2, 10.0)
    show(agent, 1, trace)
    assert agent.compute_values(1).tolist() == pytest.approx([7 + 9, 7 + 9, 7 + 9])
    assert agent.compute_values(0).tolist() == pytest.approx([-1 + 0.9 * 16] * 3)
    assert env.action_space.n == 3


def test_trap_12_termination_is_weighed_at_the_state_reached():
    agent = make_intra(SmdpEnv(make_random_smdp(0, states=4, actions=3)))
    agent.table.update(agent._discretise(1), 1, 4.0)
    agent.table.update(agent._discretise(1), 2, 20.0)
    show(agent, 1, [Step(0, 0, -1.0, 1, ALL, ((1, 0.25),))])
    assert agent.compute_values(0)[1] == pytest.approx(-1 + 0.9 * (0.75 * 4 + 0.25 * 20))


def test_trap_15_an_option_that_is_no_function_of_the_state_is_learned_as_a_whole_only():
    agent = make_intra(SmdpEnv(make_random_smdp(0, states=4, actions=3)))
    trace = [Step(0, 0, -1.0, 1, ALL, ((0, 1.0),)), Step(1, 0, -1.0, 2, ALL, ((0, 1.0),))]
    agent.table.update(agent._discretise(2), 0, 10.0)
    show(agent, 1, trace)
    assert agent.compute_values(1)[1] == 0, "no update inside"
    assert agent.compute_values(0)[1] == pytest.approx(-1 - 0.9 + 0.81 * 10), "one for the decision"


def test_no_maximum_is_taken_where_the_trace_does_not_say_what_is_legal():
    agent = make_intra(SmdpEnv(make_random_smdp(0, states=4, actions=3)))
    agent.table.update(agent._discretise(1), 2, 1e6)
    trace = [Step(0, 0, -1.0, 1, None, ((0, 1.0), (1, 0.0))), Step(1, 0, -1.0, 2, None, ((0, 1.0), (1, 1.0)))]
    show(agent, 1, trace)
    assert agent.compute_values(0)[0] == 0, "would need the maximum at state 1"
    assert agent.compute_values(0)[1] == pytest.approx(-1 - 0.9), "option 1 goes on there and needs none"


def test_a_random_choice_is_repeated_within_its_episode_alone():
    agent = make_intra(SmdpEnv(make_random_smdp(0, states=4, actions=3)), repeats=(1000,))

    def choose(**fields):
        choice = int(agent.act(0, ALL.astype(np.bool_)))
        show(agent, choice, [Step(0, choice, -1.0, 1, ALL, ((choice, 1.0),))], **fields)
        return choice

    assert len({choose() for _ in range(30)}) == 1
    assert {choose(terminated=True) for _ in range(30)} == {0, 1, 2}


def test_an_environment_without_traces_is_refused_with_the_way_out():
    agent = make_intra(env := SmdpEnv(make_random_smdp(0)))
    with pytest.raises(StepContractError, match=r"trace=True"):
        learn(agent, env, 50)


@pytest.mark.nightly
def test_intra_option_learning_needs_less_experience_than_option_by_option():
    def solved_share(agent_class):
        env = ButtonGrid(trace=True)
        agent = agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(gamma=0.95, **EXPLORE))
        learn(agent, env, 1_000)
        return np.mean([agent.compute_values([x, y, 1, 1])[6] > 0 for x in range(13) for y in range(13) if x or y])

    assert solved_share(IntraOptionQ) > 2 * solved_share(QLearning)


# --- Taxi -------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_greedy_q_learning_on_taxi_is_exactly_optimal():
    """7.93 is the mean over the 300 starts of the best return, each found by breadth-first search (below)."""
    env = gymnasium.make("Taxi-v4").unwrapped
    agent = make_q_learning(env, gamma=1.0, learning_rate=1.0)
    env.reset(seed=0)
    transitions = []
    for state in range(500):
        for action in range(6):
            env.s = state
            step = env.step(action)
            transitions.append(make_transition(state, action, np.ones(6, np.bool_), step, 1.0))
    for _ in range(20):
        for transition in transitions:
            agent.observe(transition)

    starts = np.flatnonzero(env.initial_state_distrib)
    returns = []
    for start in starts:
        state, total, terminated = start, 0.0, False
        env.s = start
        while not terminated:
            action = choose_best(agent.compute_values(state), read_action_mask({}, 6))
            state, reward, terminated, _, _ = env.step(action)
            total += reward
        returns.append(total)
    best = [find_best_taxi_return(env, start) for start in starts]
    assert len(starts) == 300
    assert returns == best
    assert round(float(np.mean(returns)), 2) == 7.93


def find_best_taxi_return(env, start):
    """Fewest steps to the goal by breadth-first search in the environment's own table; -1 each, the last 20."""
    frontier, seen, steps = [start], {start}, 0
    while True:
        steps += 1
        following = []
        for state in frontier:
            for action in range(6):
                [(_, reached, reward, terminated)] = env.P[state][action]
                if terminated and reward == 20:
                    return 20.0 - (steps - 1)
                if reward == -1 and reached not in seen:
                    seen.add(reached)
                    following.append(reached)
        frontier = following


# --- discretisation -----------------------------------------------------------------------


def test_states_a_bin_apart_are_told_apart_and_nearer_ones_are_not():
    space = gymnasium.spaces.Box(np.array([-10.0, 0.0]), np.array([10.0, 1.0]), dtype=np.float64)
    agent = QLearning(space, gymnasium.spaces.Discrete(2), 0, QLearningSettings(bins=21))
    agent.table.update(agent._discretise(np.array([3.0, 1.0])), 0, 1.0)
    assert agent.compute_values(np.array([3.4, 1.0]))[0] != 0
    assert agent.compute_values(np.array([4.0, 1.0]))[0] == 0
    assert agent.compute_values(np.array([3.0, 0.0]))[0] == 0


def test_pictures_are_refused_with_the_agents_that_take_them():
    space = gymnasium.spaces.Box(0, 255, (84, 84, 3), np.uint8)
    with pytest.raises(UnsupportedSpaceError, match="dqn or ppo"):
        QLearning(space, gymnasium.spaces.Discrete(2), 0)
