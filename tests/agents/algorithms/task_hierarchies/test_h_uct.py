"""H-UCT comes to the exact values of nested tasks, with chance in the moves and with pseudo-rewards."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.h_uct import HUct, Sampled, _Search
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import maxq
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.checks import check_agent
from tests.agents.running import learn
from tests.classic.chain import FIRST, LAST, LENGTH, START, Chain
from tests.classic.empty_room import EmptyRoom
from tests.classic.exact import (
    NestedTask,
    find_fewest_primitives,
    find_recursive_optimum,
    find_values,
    make_model,
)
from tests.classic.goal_grid import GoalGrid
from tests.classic.grid import EAST, SOUTH, Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

BOTH = np.ones(2, np.bool_)


def make_simulator(env):
    mask = np.ones(env.actions, np.bool_)

    def simulate(observation, primitive, rng):
        possible = env.outcomes(observation, primitive)
        outcome = possible[int(rng.choice(len(possible), p=[each.probability for each in possible]))]
        return Sampled(outcome.reward, outcome.next_state, mask, outcome.terminated)

    return simulate


def make(env, hierarchy=None, simulator=True, agent_class=HUct, seed=0, **settings):
    chosen = HUct.Settings(**{"gamma": 1.0} | settings)
    given = make_simulator(env) if simulator else None
    return agent_class(env.observation_space, env.action_space, seed, chosen, hierarchy, given)


# --- the chain: chance in the moves ----------------------------------------------------

VISITED = np.arange(2 * LENGTH) >= LENGTH
HOME = np.arange(2 * LENGTH) % LENGTH == FIRST


def make_chain_tasks():
    """Go far, to the last position, for a pseudo-reward of 1; or home, to the first."""
    return maxq(
        {"root": ["far", "home"], "far": [0, 1], "home": [0, 1]},
        {"far": lambda seen: bool(VISITED[seen.observation]), "home": lambda seen: bool(HOME[seen.observation])},
        pseudo={"far": lambda seen: 1.0},
    )


def solve_chain(gamma):
    far, home = NestedTask("far", [0, 1], VISITED, VISITED.astype(float)), NestedTask("home", [0, 1], HOME)
    root = NestedTask("root", [far, home], np.zeros(2 * LENGTH, bool))
    return find_recursive_optimum(Chain().make_tables(), root, gamma)


@pytest.mark.nightly
@pytest.mark.nightly_for("1.0")
@pytest.mark.parametrize("gamma", [1.0, 0.9])
def test_the_chain_is_planned_to_its_exact_value(gamma):
    agent = make(Chain(), make_chain_tasks(), gamma=gamma, simulations=2_000, return_range=1.0, exploration=0.2)
    exact = solve_chain(gamma).values["root"][START]
    assert gamma < 1 or exact == pytest.approx(0.208)
    values = agent.plan(agent.hierarchy.root, Seen(START, BOTH), np.random.default_rng(0))
    assert values.max() == pytest.approx(exact, abs=0.02)


@pytest.mark.nightly
def test_the_first_primitives_are_those_of_the_exact_solution():
    agent = make(Chain(), make_chain_tasks(), gamma=0.9, simulations=800, return_range=1.0, exploration=0.2)
    rng = np.random.default_rng(0)
    assert [agent.act_greedy(position, BOTH, rng) for position in (START, LAST - 1)] == [1, 1]
    assert [agent.act_greedy(position + LENGTH, BOTH, rng) for position in (START, START + 1)] == [0, 0]


# --- pseudo-rewards and coupled tasks --------------------------------------------------


class TwoDoors(TabularEnv):
    """A hall with two doors, 1 and 2, both one move away; then 0 or 1 more moves to the end; 3 is the end.

    Door 1 is paid -1 and leads on at -5; door 2 is paid -2 and leads on at -1.
    """

    def __init__(self):
        super().__init__(4, 2, 50)

    def outcomes(self, state, action):
        if state == 0:
            return [Outcome(1.0, 1, -1.0)] if action == 0 else [Outcome(1.0, 2, -2.0)]
        return [Outcome(1.0, 3, {1: -5.0, 2: -1.0, 3: 0.0}[state], True)]

    def make_starts(self):
        return make_uniform([0], 4)


def make_door_tasks(pseudo=None):
    leave = {"leave": lambda seen: seen.observation in (1, 2, 3)}
    return maxq({"root": ["leave", 0], "leave": [0, 1]}, leave, pseudo={} if pseudo is None else {"leave": pseudo})


def plan_doors(pseudo=None, agent_class=HUct):
    agent = make(TwoDoors(), make_door_tasks(pseudo), agent_class=agent_class, simulations=200)
    return agent.plan(agent.hierarchy.root, Seen(0, BOTH), np.random.default_rng(0))[0]


def test_a_task_is_optimal_for_itself_and_its_caller_is_told_the_truth():
    """Leaving by door 1 is cheaper for the task and dearer after; a pseudo-reward for door 2 moves the choice alone."""
    assert plan_doors() == pytest.approx(-1 - 5, abs=0.15), "the mean of what followed holds door 2's share"
    assert plan_doors(lambda seen: 10.0 if seen.observation == 2 else 0.0) == pytest.approx(-2 - 1, abs=0.15)


class TellsItsPseudoReward(HUct):
    """What the caller is told holds the pseudo-reward."""

    def plan(self, task, seen, rng):
        search = _Search(self, rng)
        for _ in range(self.settings.simulations):
            search.simulate(task, seen, self.settings.depth)
        for node in search.nodes.values():
            node.told = node.own
        return search.get_node(task, seen).compute_values(search, task, seen)


def test_pseudo_reward_in_what_a_caller_is_told_is_seen():
    assert plan_doors(lambda seen: 10.0 if seen.observation == 2 else 0.0, TellsItsPseudoReward) > 0


# --- bounds, counts, and without a simulator -------------------------------------------


def test_a_task_that_never_ends_leaves_budget_for_its_caller():
    """`walk` never ends; with patience the caller's other child is still found behind it."""
    hierarchy = maxq({"root": ["walk", 1], "walk": [0]}, {"walk": lambda seen: False})
    env = TwoDoors()
    env.outcomes = lambda state, action: [Outcome(1.0, 0, -1.0)] if action == 0 else [Outcome(1.0, 3, 7.0, True)]
    agent = make(env, hierarchy, patience=3, simulations=50, depth=40)
    values = agent.plan(agent.hierarchy.root, Seen(0, BOTH), np.random.default_rng(0))
    assert values[1] == pytest.approx(7.0)
    assert values[0] > 0, "given up after three primitives, and gone on from there"


def test_counts_are_kept_by_task_and_state():
    agent = make(Chain(), make_chain_tasks())
    search = _Search(agent, np.random.default_rng(0))
    root = agent.hierarchy.root
    search.simulate(root, Seen(START, BOTH), 50)
    search.simulate(root, Seen(START, BOTH), 50)
    node = search.get_node(root, Seen(START, BOTH))
    assert node.visits >= 2 and (node.counts >= 1).all(), "each child is tried before any is tried again"
    assert all(each.visits == each.counts.sum() for each in search.nodes.values())


@pytest.mark.nightly
def test_without_a_simulator_it_explores_what_it_never_did_and_then_plans():
    env = GoalGrid(Grid(["    ", " ## ", "    "]), 0, 50)
    agent = make(env, simulator=False, gamma=0.9, optimistic_value=1.0, simulations=60, depth=20)
    learn(agent, env, 120)
    evaluation = evaluate(agent, env, 20, 0)
    fewest = find_fewest_primitives(env.make_tables())[1:].mean()
    assert evaluation.success_rate == 1.0 and evaluation.mean_length == pytest.approx(fewest, abs=1.0)
    assert make(env).privileges == ("simulator",) and agent.privileges == ()


def test_an_unknown_primitive_ends_the_simulation_at_the_optimistic_value():
    agent = make(Chain(), simulator=False, optimistic_value=3.0, simulations=20)
    step = (START + 1, -1.0, False, False, {})
    agent.choose = lambda stack, view, legal, seen: 1
    agent.act(START, BOTH)
    agent.observe(make_transition(START, 1, BOTH, step, 1.0))
    del agent.choose
    values = agent.plan(agent.hierarchy.root, Seen(START, BOTH), np.random.default_rng(0))
    assert values == pytest.approx([3.0, -1.0 + 3.0])


def test_without_tasks_it_is_uct():
    env = EmptyRoom(60)
    agent = make(env, gamma=0.9, simulations=400, depth=30)
    exact = find_values(make_model(env.make_tables(), 0.9))
    rng = np.random.default_rng(0)
    beside = agent.plan(agent.hierarchy.root, Seen(49, np.ones(4, np.bool_)), rng)
    assert int(beside.argmax()) == SOUTH and beside.max() == pytest.approx(1.0)
    two_away = agent.plan(agent.hierarchy.root, Seen(48, np.ones(4, np.bool_)), rng)
    assert int(two_away.argmax()) in (SOUTH, EAST) and two_away.max() == pytest.approx(exact[48], abs=0.15)


def test_it_keeps_the_contract_of_agents_with_tasks_and_a_simulator():
    class OnChain(HUct):
        def __init__(self, observation_space, action_space, seed, settings=None):
            tasks = maxq({"root": ["go"], "go": range(int(action_space.n))}, {"go": lambda seen: False})
            super().__init__(observation_space, action_space, seed, settings, tasks)

    check_agent(OnChain, HUct.Settings(simulations=3, depth=5), decisions=20)
