"""MAXQ reaches the exact values of nested tasks, with pseudo-rewards and without; every trap on the way is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.maxq_q import MaxqQ
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import maxq
from tests.agents.hierarchy.four_rooms_tasks import HOME, make_nested_walks, make_walks
from tests.agents.hierarchy.taxi_runs import DYNAMICS, compare_ten_seeds, measure_taxi
from tests.agents.hierarchy.taxi_tasks import make_taxi_tasks
from tests.agents.running import learn
from tests.classic.exact import find_recursive_optimum, find_values, make_model
from tests.classic.four_rooms import FourRooms
from tests.classic.tabular import State
from tests.classic.taxi import Taxi, make_task_graph

EXACT = {"gamma": 0.9, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0}
ALL = np.ones(4, np.bool_)


def walk_everywhere(agent_class, **settings):
    """Random choices until the walks are known; then every walk once, greedily, from every cell, and home from there.

    A completion is the value of going on after the child *as it runs*, so it is exact only under exact children.
    """
    env = FourRooms(HOME, "none", horizon=60)
    agent = agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**EXACT | settings),
                        make_walks())
    learn(agent, env, 45_000)
    agent = restart(agent, env, agent_class)
    rng = np.random.default_rng(0)
    for cell in range(1, env.states):
        for first in agent.hierarchy.root.legal(Seen(cell, ALL), None).nonzero()[0]:
            walks = iter([int(first)])
            agent.choose = lambda stack, view, legal, seen, walks=walks: (
                next(walks, 4) if len(stack) == 1 else agent.choose_greedy(stack, view, legal, seen, rng)
            )
            env.reset()
            env.set_state(State(cell))
            observation, is_over = cell, False
            while not is_over:
                action = agent.act(observation, ALL)
                transition = make_transition(observation, action, ALL, env.step(action), agent.gamma)
                agent.observe(transition)
                observation, is_over = transition.next_observation, transition.terminated or transition.truncated
    return agent, env


def restart(agent, env, agent_class):
    """The same agent with no call running."""
    fresh = agent_class(env.observation_space, env.action_space, 0, agent.settings, make_walks())
    fresh.load_state_dict({**agent.state_dict(), "stack": [], "way": []})
    return fresh


def drop_pseudo(root):
    children = [child if isinstance(child, int) else replace(child, pseudo=None) for child in root.children]
    return replace(root, children=children)


def measure_errors(agent, solution, graph):
    """Largest distance of a task's value from the exact one, over states in which it is not over."""
    tasks = agent.hierarchy.tasks
    return {
        nested.name: max(
            abs(agent.compute_task_value(tasks[nested.name], Seen(state, ALL)) - solution.values[nested.name][state])
            for state in np.flatnonzero(~nested.over)
            if state != HOME
        )
        for nested in (graph, *graph.children)
    }


@pytest.mark.nightly
@pytest.mark.parametrize("pseudo_rewards", [pytest.param(False, marks=pytest.mark.slow), True])
def test_every_task_is_worth_its_exact_value_with_pseudo_rewards_and_without(pseudo_rewards):
    """Starts anywhere, alpha 1: after enough walks every table holds what solving task by task gives.

    It sees a bootstrap after a task's end (which adds the value of going on), a maximum over the wrong completion (the
    walk to a hallway would be valued as a walk home), and pseudo-reward in what callers add up.
    """
    agent, env = walk_everywhere(MaxqQ, pseudo_rewards=pseudo_rewards)
    graph = make_nested_walks() if pseudo_rewards else drop_pseudo(make_nested_walks())
    errors = measure_errors(agent, find_recursive_optimum(env.make_tables(), graph, 0.9), graph)
    assert max(errors.values()) < 1e-9, errors


class BootstrapsOverTheEnd(MaxqQ):
    def complete(self, returned, task, way):
        return super().complete(returned._replace(ended=False), task, way)


class MaximisesWhatItReports(MaxqQ):
    def compute_task_value(self, task, seen):
        return max(
            self.compute_value(child, seen) + self.tables["completion"].get(self.make_key(task, choice, seen))
            for choice, child in enumerate(task.children)
            if task.legal(seen, None)[choice]
        )


class ReportsPseudoReward(MaxqQ):
    def compute_task_value(self, task, seen):
        return float(self.compute_choice_values(task, seen).max())


class LearnsFromCutCalls(MaxqQ):
    def learn(self, step, returns):
        return super().learn(step, [each._replace(cut=False) for each in returns])


@pytest.mark.slow  # `tests/mutations/task_hierarchies.py` plants the same bugs
@pytest.mark.parametrize(
    "broken", [BootstrapsOverTheEnd, MaximisesWhatItReports, ReportsPseudoReward]
)
def test_each_trap_moves_some_value_away_from_the_exact_one(broken):
    agent, env = walk_everywhere(broken)
    graph = make_nested_walks()
    errors = measure_errors(agent, find_recursive_optimum(env.make_tables(), graph, 0.9), graph)
    assert max(errors.values()) > 0.01, errors


def test_one_child_of_three_primitives_teaches_the_completion_from_every_state_on_its_way():
    hierarchy = maxq({"root": ["walk", 1], "walk": [0]}, {"walk": lambda seen: seen.observation == 3})
    env = FourRooms(None, "none")
    agent = MaxqQ(env.observation_space, env.action_space, 0, MaxqQ.Settings(**EXACT), hierarchy)
    root, walk = agent.hierarchy.root, agent.hierarchy.tasks["walk"]
    agent.tables["completion"].update(agent.make_key(root, 1, Seen(3, ALL)), 10.0)
    # what others earn where `walk` is over
    agent.tables["primitive"].update(agent._make_primitive_key(0, Seen(3, ALL)), -7.0)
    agent.choose = lambda stack, view, legal, seen: 0
    for cell in range(3):
        assert agent.act(cell, ALL) == 0
        agent.observe(make_transition(cell, 0, ALL, (cell + 1, -1.0, False, False, {}), 0.9))
    after = [agent.tables["completion"].get(agent.make_key(root, 0, Seen(cell, ALL))) for cell in range(3)]
    assert after == pytest.approx([0.9**3 * 10, 0.9**2 * 10, 0.9 * 10])
    assert agent.compute_task_value(walk, Seen(2, ALL)) == pytest.approx(-1.0), "nothing after its own end"


@pytest.mark.parametrize(("agent_class", "learned"), [(MaxqQ, False), (LearnsFromCutCalls, True)])
def test_a_caller_learns_nothing_from_a_call_that_was_cut(agent_class, learned):
    env = FourRooms(HOME, "none")
    agent = agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**EXACT), make_walks())
    root = agent.hierarchy.root
    agent.choose = lambda stack, view, legal, seen: 0
    agent.tables["completion"].update(agent.make_key(root, 4, Seen(2, ALL)), 10.0)
    assert agent.act(1, ALL) == 0
    agent.observe(make_transition(1, 0, ALL, (2, -1.0, False, True, {}), 0.9))
    assert (agent.make_key(root, 0, Seen(1, ALL)) in agent.tables["completion"]) == learned
    walk = agent.hierarchy.tasks["to 25"]
    assert agent.make_key(walk, 0, Seen(1, ALL)) in agent.tables["completion"], "the primitive itself came to its end"


# --- tasks whose policy is given --------------------------------------------------------


def make_walker(**settings):
    """A root that may call `walk`, whose policy is to go on with primitive 0 until position 3."""
    hierarchy = maxq({"root": ["walk", 1], "walk": [0, 1]}, {"walk": lambda seen: seen.observation >= 3},
                     {name: lambda seen: int(seen.observation) for name in ("root", "walk", 0, 1)},
                     policies={"walk": lambda seen: 0})  # fmt: skip
    env = FourRooms(None, "none")
    agent = MaxqQ(env.observation_space, env.action_space, 0, MaxqQ.Settings(**EXACT | settings), hierarchy)
    agent.choose = lambda stack, view, legal, seen: 0
    return agent


def walk_to(agent, last, terminated=False, truncated=False):
    for cell in range(last):
        assert agent.act(cell, ALL) == 0
        over = cell == last - 1
        result = cell + 1, 8.0 if cell == 2 else -1.0, terminated and over, truncated and over, {}
        agent.observe(make_transition(cell, 0, ALL, result, agent.gamma))
    walk = agent.hierarchy.tasks["walk"]
    return [agent.compute_value(walk, Seen(cell, ALL)) for cell in range(3)]


@pytest.mark.parametrize("polled", ["never", "always"])
def test_one_call_of_a_given_policy_teaches_its_value_from_every_state_on_the_way(polled):
    """Learned one step at a time instead, the end of a walk of 30 primitives would need 30 calls to be felt."""
    agent = make_walker(polled=polled)
    for _ in range(3 if polled == "always" else 1):  # polled, each call is cut after one primitive, and bootstraps
        values = walk_to(agent, 3, terminated=True)
    assert values == pytest.approx([-1 - 0.9 + 0.81 * 8, -1 + 0.9 * 8, 8])
    again = make_walker(polled=polled)
    again.load_state_dict(agent.state_dict())
    assert walk_to(again, 0) == values


def test_a_given_policy_that_was_cut_goes_on_with_what_is_known_of_the_rest():
    agent = make_walker()
    assert walk_to(agent, 2, truncated=True) == pytest.approx([-1.9, -1, 0]), "nothing is known of the rest"
    walk_to(agent, 3)
    before = walk_to(agent, 0)
    assert walk_to(agent, 2, truncated=True) == pytest.approx(before), "a cut is no end"


@pytest.mark.nightly
def test_without_a_hierarchy_it_is_q_learning():
    env = FourRooms(HOME, "none", horizon=60)
    agent = MaxqQ(env.observation_space, env.action_space, 0, MaxqQ.Settings(**EXACT))
    learn(agent, env, 20_000)
    exact = find_values(make_model(env.make_tables(), 0.9))
    root = agent.hierarchy.root
    values = [agent.compute_task_value(root, Seen(state, ALL)) for state in range(1, env.states)]
    assert values == pytest.approx(exact[1:], abs=1e-9)


# --- Taxi ------------------------------------------------------------------------------

def make_driver(env, seed, rates):
    settings = MaxqQ.Settings(epsilon_steps=50_000, **rates)
    return MaxqQ(env.observation_space, env.action_space, seed, settings, make_taxi_tasks())


def compute_taxi_optima(dynamics):
    """Mean value of the first state: flat optimum, and recursive optimum of the task graph."""
    env = Taxi(**DYNAMICS[dynamics])
    tables = env.make_tables()
    nested = find_recursive_optimum(tables, make_task_graph(env.states), 1.0)
    return tables.starts @ find_values(make_model(tables, 1.0)), tables.starts @ nested.values["root"]


@pytest.mark.slow
def test_taxi_is_solved_in_three_thousand_episodes():
    flat, recursive = compute_taxi_optima("still")
    assert flat == pytest.approx(recursive)
    mean, error = measure_taxi(make_driver, "still", 3_000, 0, 1_000)
    assert mean == pytest.approx(recursive, abs=4 * error)


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_taxi_is_solved_over_ten_seeds_in_all_dynamics(dynamics):
    """One or two minutes of one core each. 0.1 is left for what 3,000 episodes do not settle."""
    _, recursive = compute_taxi_optima(dynamics)
    gain, error = compare_ten_seeds("maxq-q", make_driver, dynamics, 3_000, 500, recursive)
    assert -0.1 - 4 * error <= gain <= 4 * error
