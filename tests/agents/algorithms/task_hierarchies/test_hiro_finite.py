"""HIRO and HRAC: the off-policy correction against brute force, an oracle's worker, exact and learned adjacency."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.algorithms.task_hierarchies.hiro_finite import HiroFinite, Window
from hrl_escape.agents.algorithms.task_hierarchies.hrac_finite import HracFinite
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, make_goal_space
from hrl_escape.checks import check_agent
from tests.agents.running import interact, learn
from tests.classic.four_rooms import GRID, FourRooms, count_primitives_between
from tests.classic.goal_grid import GoalGrid
from tests.classic.grid import Grid

SHIFTS = np.array([(down, right) for down in range(-2, 3) for right in range(-2, 3) if down or right], np.float64)
CELLS = np.array(GRID.cells, np.float64)
HERE = GoalSpace(lambda cell: CELLS[cell], SHIFTS, is_relative=True)


def make(env, space=HERE, agent_class=HiroFinite, seed=0, **settings):
    return agent_class(env.observation_space, env.action_space, seed, HiroFinite.Settings(**settings), space)


def learn_something(agent_class=HiroFinite, decisions=600, **settings):
    env = FourRooms(None, "none", horizon=100)
    agent = make(env, agent_class=agent_class, **{"window": 4, "epsilon_steps": 10**9} | settings)
    learn(agent, env, decisions)
    return agent


def sum_by_hand(agent, window, goal):
    """Log-likelihood of a window under a goal: told anew at each logged state, up to the last primitive."""
    total = 0.0
    for index in range(len(window.actions)):
        left = goal + window.points[0] - window.points[index]
        values = agent.compute_worker_values(window.cells[index], left) / agent.settings.temperature
        total += values[window.actions[index]] - np.log(np.exp(values).sum())
    return total


@pytest.mark.nightly
def test_a_goal_is_as_likely_as_the_product_over_the_logged_way():
    agent = learn_something()
    for window in agent._replay[::20]:
        assert len(window.points) == len(window.actions) + 1
        expected = [sum_by_hand(agent, window, goal) for goal in SHIFTS]
        assert agent.compute_likelihoods(window) == pytest.approx(expected)
        assert agent.relabel(window) == (window.goal if expected[window.goal] >= max(expected) - 1e-12
                                         else int(np.argmax(expected)))


def test_what_went_north_under_the_name_of_south_is_called_north_today():
    agent = make(FourRooms(None))
    cells = [GRID.numbers[row, 3] for row in (5, 4, 3)]
    for cell, left in zip(cells[:-1], (-2.0, -1.0), strict=True):
        agent.tables["worker"].update(np.int32(cell).tobytes() + np.array([left, 0.0]).tobytes(), 0, 5.0)
    south, north = (int(np.flatnonzero((SHIFTS == (way, 0)).all(axis=1))[0]) for way in (2, -2))
    legal = np.ones(len(SHIFTS), np.bool_)
    window = Window(np.int32(cells[0]), legal, south, 7.0, 0.5, np.int32(cells[2]), legal,
                    np.array(cells[:-1], np.int32), CELLS[cells], np.ones((2, 4), np.bool_), np.array([0, 0]))
    assert agent.relabel(window) == north
    agent.tables["manager"].update(np.int32(cells[2]).tobytes(), 0, 8.0)
    agent._learn_manager(window)
    values = agent.tables["manager"].get_values(np.int32(cells[0]).tobytes())
    assert values[north] == pytest.approx(0.5 * (7.0 + 0.5 * 4.0)) and values[south] == 0
    assert make(FourRooms(None), correction=False).relabel(window) == south


def test_windows_hold_what_the_manager_is_to_learn():
    env = FourRooms(None, "none", horizon=10)
    agent = make(env, window=4, gamma=0.9)
    rewards, lengths = [], []
    for transition in interact(agent, env, 50):
        rewards.append(transition.reward)
        if agent._added > len(lengths):
            lengths.append(len(agent.latest.actions))
            assert agent.latest.bootstrap == pytest.approx(0.9 ** lengths[-1]), "a cut bootstraps"
    assert lengths == [4, 4, 2] * 5


def test_the_distance_left_is_what_the_worker_pays():
    goal = np.array([2.0, 1.0])
    start, north = GRID.numbers[4, 3], GRID.numbers[3, 3]
    assert HERE.advance(goal, start, north).tolist() == [3.0, 1.0], "what is left grows with the wrong way"
    assert HERE.measure(goal, start) == pytest.approx(5**0.5)
    assert not HERE.is_reached(goal, start) and HERE.is_reached(np.zeros(2), start)
    assert HERE.locate(goal, start).tolist() == [6.0, 4.0]


@pytest.mark.slow
def test_the_worker_of_an_oracle_goes_within_5_percent_of_the_shortest_way():
    """The oracle names what is left, cut to two cells each way; training named displacements at random, in the room."""
    grid = Grid(["....."] * 5)
    cells = np.array(grid.cells, np.float64)
    space = GoalSpace(lambda cell: cells[cell], SHIFTS, is_relative=True)
    env = GoalGrid(grid, None, horizon=50)
    settings = HiroFinite.Settings(window=4, epsilon_start=1.0, epsilon_end=1.0, correction=False, batch_size=1,
                             learning_rate=1.0, temperature=1e6, worker_gamma=0.5)

    def count_steps(start, ends):
        return np.where(((ends >= 0) & (ends <= 4)).all(axis=-1), np.abs(ends - start).sum(axis=-1), np.inf)

    agent = HracFinite(env.observation_space, env.action_space, 0, settings, space, count_steps)
    learn(agent, env, 15_000)
    walked = shortest = 0
    for start in range(25):
        for goal in set(range(25)) - {start}:
            cell, steps, left = start, 0, np.zeros(2)
            while cell != goal and steps < 60:
                if steps % 4 == 0 or not left.any():
                    left = np.clip(cells[goal] - cells[cell], -2, 2)
                there = grid.move(cell, int(agent.compute_worker_values(np.int32(cell), left).argmax()))
                cell, steps, left = there, steps + 1, space.advance(left, cell, there)
            walked, shortest = walked + steps, shortest + int(np.abs(cells[goal] - cells[start]).sum())
    assert shortest <= walked <= 1.05 * shortest


@pytest.mark.nightly
def test_adjacency_is_exact_where_it_is_given_and_never_more_than_that_where_it_is_learned():
    """Learned within windows of 4: no pair that is farther, and nearly every pair that is not."""
    learned = learn_something(HracFinite, 8_000, temperature=1e6, correction=False, batch_size=1)
    learned_space, settings = spaces.Discrete(len(GRID)), HiroFinite.Settings(window=4)
    exact = HracFinite(learned_space, spaces.Discrete(4), 0, settings, HERE, count_primitives_between)
    assert learned_space.n == len(CELLS) and exact.privileges == ("goals", "adjacency")
    share = []
    for cell, point in enumerate(CELLS):
        targets = HERE.locate(SHIFTS, cell)
        truth = count_primitives_between(point, targets) <= 4
        assert (exact.find_adjacent(point, targets) == truth).all()
        found = learned.find_adjacent(point, targets)
        assert not (found & ~truth).any()
        share.append((found.sum(), truth.sum()))
    assert np.divide(*np.sum(share, axis=0)) > 0.75
    doorway = GRID.numbers[3, 5]  # a wall lies two rows above the doorway's far side
    seen = exact.hierarchy.see(doorway, np.ones(4, np.bool_))
    legal = np.ones(len(SHIFTS), np.bool_)
    assert exact.find_allowed(seen, legal).sum() < legal.sum()
    nowhere = HracFinite(spaces.Discrete(104), spaces.Discrete(4), 0, HiroFinite.Settings(window=4), HERE)
    assert nowhere.find_allowed(seen, legal).all(), "where none is known to be near, all may be named"


@pytest.mark.parametrize("agent_class", [HiroFinite, pytest.param(HracFinite, marks=pytest.mark.slow)])
def test_it_keeps_the_contract_of_agents_with_and_without_a_space(agent_class):
    def construct(observation_space, action_space, seed, settings):
        shifts = np.array([(0.2, 0.0), (-0.2, 0.0), (0.0, 1.0)])
        space = GoalSpace(lambda seen: np.asarray(seen, np.float64), shifts, is_relative=True)
        return agent_class(observation_space, action_space, seed, settings, space)

    construct.__name__ = agent_class.__name__
    check_agent(construct, HiroFinite.Settings(window=3, replay_capacity=20, batch_size=2), decisions=100)


def test_goals_of_a_space_are_its_bounds_and_components_that_do_not_matter_are_nan():
    space = make_goal_space(spaces.Box(np.array([0, -np.inf], np.float32), np.array([2, np.inf], np.float32)), "x")
    assert space.goals[:, 0].tolist() == [0.0, 2.0] and np.isnan(space.goals[:, 1]).all()
    assert space.list_reached(np.array([2.0, 7.0])).tolist() == [False, True]
    assert space.advance(space.goals[0], np.zeros(2), np.ones(2)) is not None
