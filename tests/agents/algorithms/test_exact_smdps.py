"""Every agent with a table on one generator of SMDPs, against exact values: masks, durations, cuts inside options.

Deterministic SMDPs, learned with alpha = 1: what an agent holds at the end is the exact value to the last digits, or
some backup of it is wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hrl_escape.agents.algorithms.intra_option_q import IntraOptionQ
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.algorithms.r_max import RMax
from hrl_escape.agents.algorithms.skills.eigenoptions import Eigenoptions
from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import FeudalRl
from hrl_escape.agents.algorithms.task_hierarchies.h_dqn import HDqn
from hrl_escape.agents.algorithms.task_hierarchies.h_uct import HUct, Sampled
from hrl_escape.agents.algorithms.task_hierarchies.hamq import Hamq
from hrl_escape.agents.algorithms.task_hierarchies.hdg import Hdg
from hrl_escape.agents.algorithms.task_hierarchies.macro_q import MacroQ
from hrl_escape.agents.algorithms.task_hierarchies.maxq_q import MaxqQ
from hrl_escape.agents.algorithms.task_hierarchies.r_maxq import RMaxq
from hrl_escape.agents.hierarchy.goal_space import GoalSet
from hrl_escape.agents.hierarchy.machine import choose, do, machine
from hrl_escape.agents.hierarchy.runner import StackAgent
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import maxq
from tests.agents.algorithms.test_tabular import GiveTrace
from tests.agents.running import learn
from tests.agents.small_envs import CutEnv, Outcome, SmdpEnv, make_random_smdp, solve, spread_options
from tests.covering import cover

GAMMA = 0.9
EXACT = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0}
SEEDS = range(3)


def make_env(seed, longest=12):
    return CutEnv(make_random_smdp(seed, states=4, actions=3, branches=1, longest=5), seed, longest)


def make(agent_class, env, settings=EXACT, **given):
    return agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**settings), **given)


def teach(agent, env, decisions=7_000):
    """Episodes of few decisions from anywhere, each cut somewhere."""
    learn(agent, env, decisions)
    return agent


def look(env, state):
    return Seen(env.observe(state), env.compute_mask(state) != 0)


def read_program(agent, seen):
    """Values at the choice point of a moment, in the order of primitives; there is none where one is legal alone."""
    values = np.full(len(seen.mask), np.nan)
    for (view, state), index in agent.table:
        if view == agent._discretise(seen.observation):
            values[seen.mask.nonzero()[0][index]] = agent.table.get(((view, state), index))
    return values


MODELS = {RMax: {"gamma": GAMMA, "states": "cells", "tolerance": 1e-13}, RMaxq: {"gamma": GAMMA, "tolerance": 1e-13}}
READ = {
    QLearning: lambda agent, seen: agent.compute_values(seen.observation),
    IntraOptionQ: lambda agent, seen: agent.compute_values(seen.observation),
    MacroQ: lambda agent, seen: agent.compute_choice_values(seen.observation),
    FeudalRl: lambda agent, seen: agent.compute_choice_values(agent.hierarchy.root, seen.observation, None),
    MaxqQ: lambda agent, seen: agent.compute_choice_values(agent.hierarchy.root, seen),
    Hamq: read_program,
    Eigenoptions: lambda agent, seen: agent.compute_values(seen.observation),
    RMax: lambda agent, seen: agent.compute_values(seen.observation),
    RMaxq: lambda agent, seen: agent.plan(agent.hierarchy.root).values[agent.number(seen)],
}


@pytest.mark.nightly_for(
    "MaxqQ-1", "MacroQ-2", "Eigenoptions-0", "RMax-1", "FeudalRl-0", "RMaxq-2", "Hamq-2", "IntraOptionQ-1")
@pytest.mark.parametrize(("agent_class", "seed"), cover(list(READ), SEEDS))
def test_values_of_choices_are_exact(agent_class, seed):
    env = make_env(seed)
    decisions = 12_000 if agent_class is Eigenoptions else 7_000  # its options go back to the same states
    agent = teach(make(agent_class, env, MODELS.get(agent_class, EXACT)), GiveTrace(env), decisions)
    exact = solve(env.smdp, GAMMA)
    for state, row in enumerate(exact):
        legal = np.isfinite(row)
        if agent_class is Hamq and legal.sum() == 1:
            continue
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


@pytest.mark.nightly_for("1", "0", "2")
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


@pytest.mark.nightly_for("0", "2")
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


# --- tasks that get stuck ---------------------------------------------------------------

ENDS = 3
"""State in which the task below the root is over."""
RETURNING = (0, 2, 3)
"""Seeds of which every call of the task below has an end."""
GRAPH = {"root": ["below", 0, 1, 2], "below": [1, 2]}
GRAPH_MAKERS = {
    "maxq-q": lambda env: make(MaxqQ, env, hierarchy=make_graph()),
    "r-maxq": lambda env: make(RMaxq, env, MODELS[RMaxq], hierarchy=make_graph()),
    "stack": lambda env: StackAgent(make_graph(learners=dict.fromkeys(GRAPH, make_learner)), env.observation_space, 0,
                                    StackAgent.Settings(gamma=GAMMA)),
}


def make_graph(**given):
    return maxq(GRAPH, {"below": lambda seen: seen.observation == ENDS}, **given)


def make_learner(views, choices, seed):
    return QLearning(views, choices, seed, QLearning.Settings(**EXACT))


def solve_graph(smdp):
    """Exact values of the choices of the task below and of the root, which starts below first, (states, choices) each.

    The task below is the best for itself, and over where it is stuck.
    """
    stuck = [state == ENDS or not (row[1] or row[2]) for state, row in enumerate(smdp)]
    nothing = (Outcome(1.0, 0, (0.0,), True),)
    below = tuple(
        ((nothing if stuck[state] else ()),
         *(tuple(replace(o, terminated=o.terminated or stuck[o.next_state])
                 for o in row[action] if not stuck[state]) for action in (1, 2)))
        for state, row in enumerate(smdp)
    )  # fmt: skip
    inner = solve(below, GAMMA)
    best = inner.argmax(axis=1)

    def run(state):
        rewards, terminated = (), False
        while not (terminated or stuck[state] or len(rewards) > 400):
            (outcome,) = smdp[state][best[state]]
            rewards, state, terminated = rewards + outcome.rewards, outcome.next_state, outcome.terminated
        assert len(rewards) <= 20, "a caller learns nothing of a call without an end"
        return (Outcome(1.0, state, rewards, terminated or not stuck[state]),)

    whole = tuple(((() if stuck[state] else run(state)), *row) for state, row in enumerate(smdp))
    return inner[:, 1:], solve(whole, GAMMA)


@pytest.mark.nightly_for("r-maxq-2", "stack-3", "maxq-q-0")
@pytest.mark.parametrize(("name", "seed"), cover(list(GRAPH_MAKERS), RETURNING))
def test_tasks_are_worth_what_they_earn_also_where_they_get_stuck(name, seed):
    """Learners of a stack bootstrap where a call is cut, in their own view, which is exact for the task below alone."""
    env = make_env(seed, longest=40)
    agent, rng = GRAPH_MAKERS[name](env), np.random.default_rng(0)
    teach(agent, env, 9_000 if name == "stack" else 3_000)
    if name == "maxq-q":  # completions are of children as they run: from now on as they run best

        def choose_below(stack, view, legal, seen):
            if len(stack) == 1:
                return int(rng.choice(legal.nonzero()[0]))
            return agent.choose_greedy(stack, view, legal, seen, rng)

        agent.choose = choose_below
        teach(agent, env, 6_000)
    inner, outer = solve_graph(env.smdp)
    for state, row in enumerate(inner if name == "stack" else outer):
        legal, seen = np.isfinite(row), look(env, state)
        found = (agent.learners["below"].compute_values(seen.observation) if name == "stack" else
                 READ[type(agent)](agent, seen))
        assert found[legal] == pytest.approx(row[legal], abs=1e-6), state


# --- programs and searches --------------------------------------------------------------


@machine
def follow(seen, side):
    yield do(side)
    yield do((yield choose([0, 1])))


@machine
def root(seen):
    while True:
        yield from follow((yield choose([0, 1])))


def test_what_a_machine_was_told_is_a_part_of_its_state():
    """Observations are hidden: only the argument says which primitive pays after the first one."""
    ways = tuple((Outcome(1.0, 1 + side, (0.0,)),) for side in (0, 1))
    pays = tuple(tuple((Outcome(1.0, 0, (float(side == action),), True),) for action in (0, 1)) for side in (0, 1))
    env = SmdpEnv((ways, *pays))
    agent = make(Hamq, env, program=root, see=lambda seen: 0)
    learn(agent, env, 200)
    found = {(state[-2][2][0], index): agent.table.get(((view, state), index)) for (view, state), index in agent.table
             if len(state) == 3}
    assert found == {(0, 0): 1.0, (0, 1): 0.0, (1, 0): 0.0, (1, 1): 1.0}


@pytest.mark.nightly_for("1", "2")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_search_does_not_change_with_the_unit_of_reward(seed):
    smdp = spread_options(make_random_smdp(seed, states=4, actions=3, branches=1, longest=5), seed)
    env, found = SmdpEnv(smdp), []
    for scale in (1.0, 100.0):

        def simulate(state, action, rng, scale=scale):
            (outcome,) = smdp[state][action]
            reward = scale * sum(GAMMA**i * r for i, r in enumerate(outcome.rewards))
            return Sampled(reward, outcome.next_state, env.compute_mask(outcome.next_state) != 0, outcome.terminated,
                           len(outcome.rewards))

        agent = make(HUct, env, {"gamma": GAMMA, "simulations": 300, "depth": 60}, simulator=simulate)
        found.append(agent.plan(agent.hierarchy.root, look(env, 0), np.random.default_rng(0)))
    legal = env.compute_mask(0) != 0
    assert found[1][legal] == pytest.approx(100 * found[0][legal])
