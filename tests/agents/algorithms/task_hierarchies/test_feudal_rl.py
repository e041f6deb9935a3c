"""Feudal learning obeys by the shortest way, at every level, and finds a goal that moved before Q-learning does."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import (
    DIRECTIONS,
    SEARCH,
    FeudalRl,
    Quadtree,
    make_feudal_hierarchy,
)
from hrl_escape.agents.hierarchy.task import Frame, Seen
from hrl_escape.errors import AgentSettingsError
from tests.agents.running import interact, learn
from tests.classic.barrier_maze import BEHIND, BEYOND, GRID, SIDE, BarrierMaze
from tests.classic.exact import find_values, make_model
from tests.classic.four_rooms import FourRooms

ALL = np.ones(4, np.bool_)
EXACT = {"gamma": 0.9, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0, "patience": 0}


def find_place(observation):
    row, column = GRID.cells[int(observation)]
    return row / SIDE, column / SIDE


def make(depth=2, seed=0, agent_class=FeudalRl, **settings):
    env = BarrierMaze()
    chosen = FeudalRl.Settings(**EXACT | settings)
    return agent_class(env.observation_space, env.action_space, seed, chosen, Quadtree(depth, find_place))


def find_exact_values(order, side, goal=BEHIND, gamma=0.9):
    """gamma^(d - 1) for the shortest way that obeys an order and leaves its square of `side` cells nowhere else.

    d is counted by breadth-first search; 0 where there is no way. An order to leave is never given at the goal.
    """
    values = np.zeros(len(GRID))
    for start in range(len(GRID)):
        distances, front = {start: 0}, [start]
        for cell in front:
            for there in GRID.list_neighbours(cell):
                (row, column), (new_row, new_column) = GRID.cells[cell], GRID.cells[there]
                way = (new_row // side - row // side, new_column // side - column // side)
                is_obeyed = there == goal and way == (0, 0) if order == SEARCH else way == DIRECTIONS[order]
                if is_obeyed:
                    values[start] = max(values[start], gamma ** distances[cell])
                if way == (0, 0) and there not in distances and there != goal:
                    distances[there] = distances[cell] + 1
                    front.append(there)
    return values


def obey(agent, cell, order, action):
    """One primitive of the last level under an order of the level above, then a cut."""
    depth = len(agent.hierarchy.tasks)

    def choose(stack, view, legal, seen):
        if len(stack) == depth:
            return action
        return order if len(stack) == depth - 1 else SEARCH

    agent.choose = choose
    assert agent.act(cell, ALL) == action
    there = GRID.move(cell, action)
    at_goal = there == BEHIND
    agent.observe(make_transition(cell, action, ALL, (there, float(at_goal), at_goal, not at_goal, {}), agent.gamma))


def list_orders(agent, cell, level):
    """Orders that a level may give in a cell."""
    task = agent.hierarchy.tasks[f"level {level}"]
    return [int(order) for order in task.legal(agent.hierarchy.see(cell, ALL), None).nonzero()[0]]


def teach_last_level(agent, sweeps):
    level = len(agent.hierarchy.tasks) - 1
    for _ in range(sweeps):
        for cell in set(range(len(GRID))) - {BEHIND}:
            for order in list_orders(agent, cell, level):
                for action in range(4):
                    obey(agent, cell, order, action)
    return agent


class ForgetsTheOrder(FeudalRl):
    """One value for all orders."""

    def make_key(self, task, view, order):
        return super().make_key(task, view, None)


def measure_errors(agent, side):
    """Largest distance from the exact values of the last level, over cells and orders."""
    task = agent.hierarchy.tasks[f"level {len(agent.hierarchy.tasks)}"]
    error = 0.0
    for order in range(SEARCH + 1):
        exact = find_exact_values(order, side)
        for cell in set(range(len(GRID))) - {BEHIND}:
            if order in list_orders(agent, cell, task.level - 1):
                error = max(error, abs(agent.compute_choice_values(task, cell, order).max() - exact[cell]))
    return error


@pytest.mark.nightly
@pytest.mark.nightly_for("1-4-12")
@pytest.mark.parametrize(("depth", "side", "sweeps"), [(2, 2, 5), (1, 4, 12)])
def test_the_last_level_obeys_every_order_by_the_shortest_way(depth, side, sweeps):
    """Each primitive is cut right after, so it also sees a cut call that is taken for one that is over."""
    assert measure_errors(teach_last_level(make(depth), sweeps), side) < 1e-9


@pytest.mark.nightly
def test_the_order_is_part_of_the_key():
    assert measure_errors(teach_last_level(make(2, agent_class=ForgetsTheOrder), 5), 2) > 0.1


@pytest.mark.nightly
def test_a_manager_over_an_obedient_one_learns_the_same_ways():
    """Its cells are single states here, each reached by one primitive, so its values are those of a last level."""
    agent = teach_last_level(make(3, patience=1), 2)
    manager = agent.hierarchy.tasks["level 3"]
    rng = np.random.default_rng(0)
    for _ in range(3):
        for cell in set(range(len(GRID))) - {BEHIND}:
            for order in list_orders(agent, cell, 2):
                for choice in set(list_orders(agent, cell, 3)) - {SEARCH}:
                    agent.choose = lambda stack, view, legal, seen, order=order, choice=choice: (
                        {1: SEARCH, 2: order, 3: choice}[len(stack)] if len(stack) < 4
                        else agent.choose_greedy(stack, view, legal, seen, rng)
                    )  # fmt: skip
                    action = agent.act(cell, ALL)
                    there = GRID.move(cell, action)
                    step = (there, float(there == BEHIND), there == BEHIND, there != BEHIND, {})
                    agent.observe(make_transition(cell, action, ALL, step, agent.gamma))
    for order in range(SEARCH + 1):
        exact = find_exact_values(order, 2)
        for cell in set(range(len(GRID))) - {BEHIND}:
            if order in list_orders(agent, cell, 2):
                view = manager.view(agent.hierarchy.see(cell, ALL), ())
                best = max(0.0, agent.compute_choice_values(manager, view, order).max())
                assert best == pytest.approx(exact[cell], abs=1e-9), (cell, order)


def test_pay_is_for_obeying_and_the_environment_pays_the_top_alone():
    """By hand: two primitives under the order east, the second leaves to the north, and the world pays 5 for each."""
    agent = make(1, penalty=0.3)
    agent.choose = lambda stack, view, legal, seen: 3 if len(stack) == 1 else 0
    start = GRID.numbers[5, 0]
    for cell in (start, GRID.move(start, 0)):
        agent.act(cell, ALL)
        agent.observe(make_transition(cell, 0, ALL, (GRID.move(cell, 0), 5.0, False, False, {}), 0.9))
    top, last = agent.hierarchy.tasks.values()
    assert agent.compute_choice_values(last, GRID.move(start, 0), 3)[0] == pytest.approx(-0.3)
    assert agent.compute_choice_values(last, start, 3)[0] == 0.0, "nothing for staying, learned before what followed"
    assert agent.compute_choice_values(top, np.array([1, 0]), None)[3] == pytest.approx(5 + 0.9 * 5)


def test_an_order_given_up_bootstraps():
    agent = make(1, patience=1)
    agent.choose = lambda stack, view, legal, seen: 3 if len(stack) == 1 else 0
    cell, there = GRID.numbers[6, 0], GRID.numbers[5, 0]
    last = agent.hierarchy.tasks["level 2"]
    agent.tables["level 2"].update(agent.make_key(last, there, 3), 3, 0.5)
    agent.act(cell, ALL)
    agent.observe(make_transition(cell, 0, ALL, (there, 0.0, False, False, {}), 0.9))
    assert [frame.task.name for frame in agent.stack] == ["level 1"]
    assert agent.compute_choice_values(last, cell, 3)[0] == pytest.approx(0.45)


def test_a_manager_between_gives_up_an_order_even_where_a_policy_obeys_its_own():
    """Moves are obeyed, so that the last level needs no patience; a search of the manager above may find nothing."""
    tree = Quadtree(2, find_place, policy=lambda observation, cell, order: order if order < SEARCH else None)
    manager, last = make_feudal_hierarchy(tree, 4, penalty=0.2, patience=3).below
    start = Seen(0, ALL)
    for task, lasting in ((manager, [0.0, 1.0]), (last, [0.0, 0.0])):
        assert [task.ends(Frame(task, SEARCH, start, primitives), start) for primitives in (5, 6)] == lasting
    assert list(manager.legal(start, SEARCH)) == [False, True, False, True, False], "no search where none is obeyed"
    assert list(last.legal(start, 1).nonzero()[0]) == [1]


@pytest.mark.nightly
def test_without_cells_it_is_q_learning():
    env = FourRooms(0, "none", horizon=60)
    agent = FeudalRl(env.observation_space, env.action_space, 0, FeudalRl.Settings(**EXACT))
    learn(agent, env, 12_000)
    exact = find_values(make_model(env.make_tables(), 0.9))
    values = [agent.compute_choice_values(agent.hierarchy.root, cell, None).max() for cell in range(1, env.states)]
    assert values == pytest.approx(exact[1:], abs=1e-9)
    assert agent.privileges == () and make().privileges == ("cells",)


def measure_after_move(depth, seed, primitives=3_000):
    """Mean length of episodes in the second half of learning with the goal moved from one corner to another."""
    agent = make(depth, seed, gamma=0.95, learning_rate=0.2, initial_value=0.5, patience=10, penalty=0.2,
                 epsilon_start=0.1, epsilon_end=0.1)  # fmt: skip
    learn(agent, BarrierMaze(BEYOND, horizon=200), primitives, seed)
    agent.load_state_dict({**agent.state_dict(), "stack": []})
    ends = [0, *(number for number, transition in enumerate(
        interact(agent, BarrierMaze(0, horizon=200), primitives, seed), 1)
        if transition.terminated or transition.truncated)]  # fmt: skip
    lengths = np.diff(ends)
    return lengths[np.array(ends[1:]) > primitives / 2].mean()


@pytest.mark.nightly
def test_after_the_goal_moved_it_is_found_sooner_than_by_q_learning():
    feudal, flat = (np.mean([measure_after_move(depth, seed) for seed in range(1)]) for depth in (2, 0))
    assert feudal < 0.5 * flat, (feudal, flat)


def test_a_place_outside_the_square_is_refused():
    with pytest.raises(AgentSettingsError, match="from 0 up to"):
        Quadtree(1, lambda observation: (0.0, 1.0)).find_cell(0, 1)
    with pytest.raises(AgentSettingsError, match="depth"):
        Quadtree(-1, lambda observation: (0.0, 0.0))
