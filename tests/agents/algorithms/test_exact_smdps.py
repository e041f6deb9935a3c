"""Every agent with a table on one generator of SMDPs, against exact values: masks, durations, cuts inside options.

Deterministic SMDPs, learned with alpha = 1: what an agent holds at the end is the exact value to the last digits, or
some backup of it is wrong.
"""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.algorithms.given.feudal_rl import FeudalRl
from hrl_escape.agents.algorithms.given.h_dqn import HDqn
from hrl_escape.agents.algorithms.given.hdg import Hdg
from hrl_escape.agents.algorithms.given.macro_q import MacroQ
from hrl_escape.agents.algorithms.intra_option_q import IntraOptionQ
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.hierarchy.goals import GoalSet
from hrl_escape.agents.hierarchy.task import Seen
from tests.agents.algorithms.test_tabular import GiveTrace
from tests.agents.running import learn
from tests.agents.small_envs import CutEnv, Outcome, make_random_smdp, solve

GAMMA = 0.9
EXACT = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0}
SEEDS = range(3)


def make_env(seed):
    return CutEnv(make_random_smdp(seed, states=4, actions=3, branches=1, longest=5), seed)


def make(agent_class, env, settings=EXACT, **given):
    return agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**settings), **given)


def teach(agent, env, decisions=8_000):
    """Episodes of few decisions from anywhere, each cut somewhere."""
    learn(agent, env, decisions)
    return agent


def look(env, state):
    return Seen(env.observe(state), env.compute_mask(state) != 0)


READ = {
    QLearning: lambda agent, seen: agent.compute_values(seen.observation),
    IntraOptionQ: lambda agent, seen: agent.compute_values(seen.observation),
    MacroQ: lambda agent, seen: agent.compute_choice_values(seen.observation),
    FeudalRl: lambda agent, seen: agent.compute_choice_values(agent.hierarchy.root, seen.observation, None),
}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("agent_class", READ)
def test_values_of_choices_are_exact(agent_class, seed):
    env = make_env(seed)
    agent = teach(make(agent_class, env), GiveTrace(env))
    exact = solve(env.smdp, GAMMA)
    for state, row in enumerate(exact):
        legal = np.isfinite(row)
        assert READ[agent_class](agent, look(env, state))[legal] == pytest.approx(row[legal], abs=1e-9), state


def pay_for(smdp, goal):
    """The worker's SMDP on the way to a goal: paid 1 by the last primitive that reaches it, which ends it."""
    return tuple(
        tuple(
            tuple(Outcome(1.0, o.next_state, (0.0,) * (len(o.rewards) - 1) + (float(o.next_state == goal),),
                          o.terminated or o.next_state == goal) for o in outcomes)
            for outcomes in row
        ) for row in smdp
    )  # fmt: skip


@pytest.mark.parametrize("seed", SEEDS)
def test_ways_to_goals_are_worth_the_discount_of_their_last_primitive(seed):
    env = make_env(seed)
    goals = GoalSet(4, lambda observation, goal: observation == goal)
    settings = {"gamma": GAMMA, "values": "table", "table_learning_rate": 1.0, "patience": 3, "worker_warmup": 10**9,
                "worker_epsilon_end": 1.0}  # fmt: skip
    agent = teach(make(HDqn, env, settings, goals=goals), env, 6_000)
    for goal in range(4):
        exact = solve(pay_for(env.smdp, goal), GAMMA)
        for state, row in enumerate(exact):
            legal = np.isfinite(row)
            if state != goal:
                found = agent.worker.compute(env.observe(state), goal)
                assert found[legal] == pytest.approx(row[legal], abs=1e-9), (goal, state)


def find_distances(smdp, goal):
    """Fewest primitives to a goal by action, (states, actions), and 30 more over an end; infinite where illegal."""
    lengths = np.full((len(smdp), len(smdp[0])), np.inf)
    for _ in range(len(smdp) + 1):
        best = lengths.min(axis=1)
        for state, row in enumerate(smdp):
            for action, outcomes in enumerate(row):
                for outcome in outcomes:
                    after = 30.0 if outcome.terminated else best[outcome.next_state]
                    lengths[state, action] = len(outcome.rewards) + (0.0 if outcome.next_state == goal else after)
    return lengths


@pytest.mark.parametrize("seed", SEEDS)
def test_distances_are_counted_in_primitives_over_legal_actions_and_never_through_an_end(seed):
    env = make_env(seed)
    agent = teach(make(Hdg, env, EXACT | {"dead_end": 30.0}), env)
    numbers = [agent.find_number(env.observe(state)) for state in range(len(env.smdp))]
    for goal in range(4):
        exact = find_distances(env.smdp, goal)
        for state in range(len(env.smdp)):
            legal = np.isfinite(exact[state])
            if state != goal:
                found = agent.distances[numbers[state], numbers[goal]]
                assert found[legal] == pytest.approx(exact[state][legal]), (goal, state)
