"""HAC: its three kinds of hindsight worked out by hand, and Four Rooms from everywhere."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.hac_finite import END, HacFinite
from tests.agents.running import learn
from tests.agents.small_envs import Outcome, SmdpEnv
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import EAST_HALLWAY, FourRooms, walk_greedily

BOTH = np.ones(2, np.bool_)
ROW = SmdpEnv(tuple(((Outcome(1.0, max(cell - 1, 0), (-1.0,)),), (Outcome(1.0, min(cell + 1, 8), (-1.0,)),))
                    for cell in range(9)))
"""Nine cells in a row, left and right."""


def make(env, seed=0, **settings):
    return HacFinite(env.observation_space, env.action_space, seed, HacFinite.Settings(**settings))


def walk(choices, cells, terminated=False, **settings):
    """An agent whose levels choose as listed, on its way through the cells."""
    agent = make(ROW, **{"learning_rate": 1.0, "attempts": 2, "gamma": 1.0, "hindsight_goals": 0} | settings)
    agent.choose = partial(lambda left, *given: left.pop(0), list(choices))
    for cell, after in zip(cells, cells[1:], strict=False):
        action = agent.act(cell, BOTH)
        is_last = after is cells[-1]
        agent.observe(make_transition(cell, action, BOTH, (after, -1.0, terminated and is_last, is_last, {}), 1.0))
    return agent


def test_an_action_is_learned_from_as_the_goal_that_was_reached():
    """Goal 7 is named in cell 1 and missed: cell 3 was reached, which now ends the episode."""
    agent = walk([7, 1, 1], [1, 2, 3], terminated=True)
    values = agent.compute_choice_values("level 1", 1, END)
    assert values[3] == 0.0 and (np.delete(values, 3) == -2.0).all()
    assert [agent.compute_choice_values("level 0", cell, 7)[1] for cell in (1, 2)] == [-2.0, -2.0], "within -H and 0"


def test_every_choice_costs_one_until_the_goal():
    agent = walk([3, 1, 1, 5, 1, 1], [1, 2, 3, 4, 5], terminated=True, attempts=4)
    assert agent.compute_choice_values("level 1", 3, END)[5] == 0.0
    assert agent.compute_choice_values("level 1", 1, END)[3] == -1.0
    assert agent.compute_choice_values("level 0", 2, 3)[1] == 0.0
    assert agent.compute_choice_values("level 0", 1, 3)[1] == -1.0


def test_goals_reached_later_teach_every_level():
    agent = walk([7, 1, 1, 1, 1], [1, 2, 3, 4, 5], hindsight_goals=60, attempts=4)
    assert agent.compute_choice_values("level 0", 1, 3)[1] == -1.0, "3 was reached at the second primitive"
    assert agent.compute_choice_values("level 0", 2, 3)[1] == 0.0
    values = agent.compute_choice_values("level 1", 1, 5)
    assert values[5] == 0.0 and (np.delete(values, 5) == -4.0).all(), "one call of four primitives reached 5"


def test_one_level_is_q_learning_with_goals_in_hindsight():
    agent = walk([1, 1, 1], [1, 2, 3, 4], terminated=True, levels=1, attempts=9, hindsight_goals=60)
    values = {goal: [agent.compute_choice_values("level 0", cell, goal)[1] for cell in (1, 2, 3)]
              for goal in (END, 3, 4, 7)}
    assert values == {END: [-2, -1, 0], 3: [-1, 0, -9], 4: [-2, -1, 0], 7: [-9, -9, -9]}


@pytest.mark.parametrize(("tested", "expected"), [(1, -2.0), (0, -1.0)])
def test_a_subgoal_that_misses_its_test_is_worth_minus_h_and_nothing_follows(tested, expected):
    agent = make(ROW, attempts=2, learning_rate=1.0, hindsight_goals=0)
    agent.tables["level 1"].update(agent._make_key(np.int32(1), END), 7, -1.0)
    choices = [7, 1, 1]
    agent.choose = lambda *given: choices.pop(0)
    for cell in (1, 2):
        agent._tested = tested
        agent.observe(make_transition(cell, agent.act(cell, BOTH), BOTH, (cell + 1, -1.0, False, False, {}), 0.99))
    assert agent.compute_choice_values("level 1", 1, END)[7] == expected


def test_levels_below_a_test_do_not_explore():
    agent = make(ROW, subgoal_tests=1.0, random_share=1.0, attempts=50)
    agent.tables["level 0"].update(agent._make_key(np.int32(4), 8), 1, 0.0)
    asked = []
    agent.choose_greedy = lambda stack, *given: asked.append(len(stack)) or (8 if len(stack) == 1 else 1)
    for _ in range(20):
        agent.act(4, BOTH)
        agent.observe(make_transition(4, 1, BOTH, (4, -1.0, False, False, {}), 0.99))
    assert asked == [1] + [2] * 20


def measure(agent, env):
    """Primitives from every cell, by the greedy policy."""
    walks = [walk_greedily(agent, env, start) for start in env.first]
    return np.array([steps if arrived else np.inf for steps, arrived in walks])


@pytest.mark.parametrize(("seed", "primitives"), [
    *(pytest.param(seed, 40_000, marks=pytest.mark.slow) for seed in range(10))])
def test_four_rooms_is_left_from_everywhere_on_ways_within_a_fifth_of_the_shortest(seed, primitives):
    env = FourRooms(EAST_HALLWAY, "none", horizon=200)
    agent = make(env, seed, learning_rate=1.0)
    learn(agent, env, primitives, seed)
    shortest = find_fewest_primitives(env.make_tables())[env.first]
    steps = measure(agent, env)
    assert np.isfinite(steps).all(), "success 100 %"
    assert (steps >= shortest).all() and steps.sum() <= 1.2 * shortest.sum()
    for table in agent.tables.values():
        values = np.array(list(table._values.values()))
        assert values.max() <= 0 and values.min() >= -5


@pytest.mark.nightly
def test_three_levels_learn_too():
    env = FourRooms(EAST_HALLWAY, "none", horizon=200)
    agent = make(env, levels=3, attempts=3)
    learn(agent, env, 2_000)
    assert {len(agent.list_calls())} == {3} and all(len(table) for table in agent.tables.values())
