"""R-MAXQ: task models equal those solved exactly once all is known, and optimism explores what leads there."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.r_maxq import RMaxq
from hrl_escape.agents.hierarchy.task import Step
from hrl_escape.agents.hierarchy.task_graph import maxq
from hrl_escape.agents.training.evaluation import evaluate
from tests.agents.hierarchy.four_rooms_tasks import HOME, make_nested_walks, make_walks
from tests.agents.hierarchy.taxi_tasks import make_taxi_tasks
from tests.agents.running import learn
from tests.classic.exact import find_recursive_optimum, find_values, make_model
from tests.classic.four_rooms import FourRooms
from tests.classic.tabular import Outcome
from tests.classic.taxi import Taxi, make_task_graph

ALL = np.ones(4, np.bool_)


def make(env, hierarchy=None, **settings):
    chosen = RMaxq.Settings(**{"gamma": 0.9, "optimistic_value": 1.0} | settings)
    return RMaxq(env.observation_space, env.action_space, 0, chosen, hierarchy)


def tell_everything(agent, env, samples=1):
    """Every primitive in every state, each outcome as often as it is probable."""
    for state in range(env.states):
        for action in range(env.actions):
            for outcome in env.outcomes(state, action):
                for _ in range(round(samples * outcome.probability)):
                    _teach(agent, state, action, outcome)


def _teach(agent, state, action, outcome):
    seen, after = (agent.hierarchy.see(each, np.ones(agent._actions, np.bool_)) for each in (state, outcome.next_state))
    agent.learn(Step(seen, action, outcome.reward, outcome.reward, 1, after, outcome.terminated, False), [])


@pytest.mark.nightly_for("none")
@pytest.mark.parametrize("slip", ["none", "direction"])
def test_models_of_tasks_are_those_of_nested_solving(slip):
    """Values, policies and where each task ends, pseudo-rewards included, with chance in the moves and without."""
    env = FourRooms(HOME, slip)
    agent = make(env, make_walks(), visits=1)
    tell_everything(agent, env, samples=9)
    exact = find_recursive_optimum(env.make_tables(), make_nested_walks(), 0.9)
    order = [agent._numbers[agent._discretise(cell)] for cell in range(env.states)]
    for name, task in agent.hierarchy.tasks.items():
        model = agent.plan(task).model
        assert model.rewards[order][1:] == pytest.approx(exact.values[name][1:], abs=1e-6), name
        if slip == "none":  # by chance two walks may be equally good and end elsewhere
            assert model.follow[np.ix_(order, order)][1:] == pytest.approx(exact.follow[name][1:], abs=1e-6), name


def test_of_two_places_that_are_one_state_each_has_its_own_legal_primitive():
    """A given policy may turn where two observations are rounded to one state, as a planner's does."""
    env = gymnasium.make("MountainCar-v0")
    hierarchy = maxq({"root": ["walk"], "walk": [0, 1, 2]}, {"walk": lambda seen: False},
                     policies={"walk": lambda seen: 0 if seen.observation[0] < -0.5 else 2})
    agent = RMaxq(env.observation_space, env.action_space, 0, RMaxq.Settings(bins=2), hierarchy)
    mask, rng = np.ones(3, np.bool_), np.random.default_rng(0)
    left, right = (np.array([at, 0.01], np.float32) for at in (-0.6, -0.4))
    assert agent._discretise(left) == agent._discretise(right)
    agent.learn(Step(agent.hierarchy.see(left, mask), 0, -1.0, -1.0, 1, agent.hierarchy.see(left, mask), False, False),
                [])
    agent.begin_episode()
    assert agent.act(left, mask) == agent.act_greedy(left, mask, rng) == 0
    agent.begin_episode()
    assert agent.act(right, mask) == agent.act_greedy(right, mask, rng) == 2


def test_an_unknown_primitive_makes_its_callers_look_worth_the_optimum():
    env = FourRooms(HOME, "none")
    agent = make(env, make_walks(), optimistic_value=7.0)
    tell_everything(agent, env)
    cell = agent._numbers[agent._discretise(60)]
    agent._counts[cell][0] = 0
    agent._plans = {}
    root = agent.hierarchy.root
    home = agent.plan(agent.hierarchy.tasks["home"]).model.rewards
    assert home[cell] == pytest.approx(7.0)
    assert agent.plan(root).values[cell].max() == pytest.approx(7.0)
    after = agent._numbers[agent._discretise(61)]
    assert home[after] == pytest.approx(0.9 * 7.0), "discounted on the way"


@pytest.mark.nightly
def test_without_a_hierarchy_it_is_r_max_and_comes_to_the_optimum():
    env = FourRooms(HOME, "none", horizon=100)
    agent = make(env)
    learn(agent, env, 6_000)
    exact = find_values(make_model(env.make_tables(), 0.9))
    values = agent.plan(agent.hierarchy.root).values.max(axis=1)
    for cell in range(1, env.states):
        assert values[agent._numbers[agent._discretise(cell)]] == pytest.approx(exact[cell], abs=1e-6)


@pytest.mark.slow
def test_with_tasks_it_explores_and_walks_home():
    env = FourRooms(HOME, "none", horizon=100)
    agent = make(env, make_walks())
    learn(agent, env, 4_000)
    evaluation = evaluate(agent, env, 50)
    assert evaluation.success_rate == 1.0
    unknown = (agent.state_dict()["counts"] < agent.settings.visits).sum()
    assert unknown < 0.05 * env.states * env.actions


def test_an_episode_that_ended_leads_nowhere():
    env = FourRooms(HOME, "none")
    agent = make(env)
    agent.choose = lambda stack, view, legal, seen: 2
    agent.act(1, ALL)
    agent.observe(make_transition(1, 2, ALL, (0, 1.0, True, False, {}), 0.9))
    assert agent._weights[agent._numbers[agent._discretise(1)]] == {}


def test_a_task_that_cannot_end_is_hopeless_not_an_error():
    env = FourRooms(None, "none", reward=0.0)
    agent = make(env, maxq({"root": ["stay", 0], "stay": [0, 1]}, {"stay": lambda seen: seen.observation == 200}),
                 gamma=1.0, optimistic_value=0.0)  # fmt: skip
    for cell in (0, 1):
        for action in range(4):
            _teach(agent, cell, action, Outcome(1.0, 1 - cell, -1.0))
    assert agent.plan(agent.hierarchy.tasks["stay"]).model.rewards[0] < -1e6


@pytest.mark.nightly_for("noisy")
@pytest.mark.parametrize(
    ("dynamics", "samples"),
    [({}, 1), ({"noisy": True}, 10), pytest.param({"fickle": True}, 10, marks=pytest.mark.slow),
     pytest.param({"noisy": True, "fickle": True}, 100, marks=pytest.mark.slow)],
    ids=["still", "noisy", "fickle", "both"],
)  # fmt: skip
def test_taxi_once_known_is_planned_to_its_exact_recursive_optimum(dynamics, samples):
    """Each outcome as often as it is probable, so that the model is exact and no seed matters."""
    env = Taxi(**dynamics)
    agent = make(env, make_taxi_tasks(), gamma=1.0, optimistic_value=20.0)
    tell_everything(agent, env, samples)
    exact = find_recursive_optimum(env.make_tables(), make_task_graph(env.states), 1.0).values["root"]
    values = agent.plan(agent.hierarchy.root).model.rewards
    order = [agent._numbers[agent._discretise(state)] for state in range(env.states)]
    assert values[order] == pytest.approx(exact, abs=1e-5)
