"""Deep abstract Q-networks: the graph of rooms that it finds is the true one, and its model of steps is exact."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.deep_abstract_q import DeepAbstractQ
from hrl_escape.checks import check_agent
from tests.agents.algorithms.task_hierarchies.test_hac_finite import measure
from tests.agents.running import learn
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import EAST_HALLWAY, GRID, HALLWAYS, ROOMS, FourRooms, make_room_mask

PLACES = {int(cell): number for number, room in enumerate(ROOMS) for cell in np.flatnonzero(make_room_mask(room))}
PLACES |= {cell: 4 + number for number, cell in enumerate(HALLWAYS)}
"""Cell -> its room, or its hallway."""
TABLES = {"worker": "table", "visits": 5, "most_states": 12}


def make(env, **settings):
    return DeepAbstractQ(env.observation_space, env.action_space, 0, DeepAbstractQ.Settings(**TABLES | settings),
                         PLACES.__getitem__)


@pytest.mark.nightly
def test_the_graph_that_it_finds_is_the_true_one_and_its_way_out_is_short():
    env = FourRooms(EAST_HALLWAY, "none", horizon=300)
    agent = make(env, visits=30, gamma=0.9, optimistic_value=1.0)
    learn(agent, env, 12_000)
    names = [int(key) for key in agent._keys]
    found = {(names[u], names[v]) for u, v in np.argwhere(agent.is_next)}
    true = {(PLACES[cell], PLACES[there]) for cell in range(len(GRID)) if cell != EAST_HALLWAY
            for there in GRID.list_neighbours(cell) if PLACES[there] != PLACES[cell]}
    assert found == true
    steps, shortest = measure(agent, env), find_fewest_primitives(env.make_tables())[env.first]
    assert np.isfinite(steps).all() and steps.sum() <= 1.2 * shortest.sum()


def walk(agent, cells, target, rewards=None, terminated=False):
    """One step towards a place, through cells from its call to its end."""
    choices = [target]
    agent.choose = lambda stack, *given: choices.pop() if stack[-1].context is None else 0
    for number, (cell, after) in enumerate(zip(cells, cells[1:], strict=False)):
        agent.act(cell, np.ones(4, np.bool_))
        reward = 0.0 if rewards is None else rewards[number]
        agent.observe(make_transition(cell, 0, np.ones(4, np.bool_), (after, reward, terminated, False, {}), 0.9))


def meet(agent, cells):
    for cell in cells:
        agent._meet(cell)
    places = [agent.find(cell) for cell in cells]
    agent.is_next[places[0], places[1:]] = True
    return places


WEST_ROOM = [GRID.numbers[cell] for cell in ((3, 3), (3, 4), (3, 5), (3, 6), (6, 2))]
"""Three cells of the north-west room up to its north hallway, that hallway, and its west hallway."""


def test_a_step_is_worth_what_it_earned_and_gamma_to_the_length_of_it():
    agent = make(FourRooms(None), gamma=0.9, recency=0.0, visits=1)
    room, north, _ = meet(agent, [WEST_ROOM[0], WEST_ROOM[3], WEST_ROOM[4]])
    walk(agent, WEST_ROOM[:4], north, [-1.0, -1.0, 5.0])
    assert agent._rewards[room, north] == pytest.approx(-1 - 0.9 + 0.81 * 5)
    assert agent._follow[room, north, north] == pytest.approx(0.9**3)
    ended = make(FourRooms(None), gamma=0.9)
    walk(ended, WEST_ROOM[2:4], meet(ended, WEST_ROOM[2:5])[1], [7.0], True)
    assert ended._follow.sum() == 0, "nothing follows where the episode terminated"


def test_a_worker_is_paid_for_its_target_and_charged_for_any_other_state_which_both_end_it():
    for target, paid in ((1, 1.0), (2, -1.0)):
        agent = make(FourRooms(None), gamma=0.9)
        room, *others = meet(agent, [WEST_ROOM[0], WEST_ROOM[3], WEST_ROOM[4]])
        worker = agent._get_worker((room, others[target - 1]))
        worker.table.update(worker._discretise(WEST_ROOM[3]), 1, 40.0)
        walk(agent, WEST_ROOM[2:4], others[target - 1])
        assert worker.compute_values(WEST_ROOM[2])[0] == pytest.approx(0.5 * paid)


def test_a_step_given_up_bootstraps():
    agent = make(FourRooms(None), gamma=0.9, patience=1)
    room, north, _ = meet(agent, [WEST_ROOM[0], WEST_ROOM[3], WEST_ROOM[4]])
    worker = agent._get_worker((room, north))
    worker.table.update(worker._discretise(WEST_ROOM[1]), 1, 40.0)
    walk(agent, WEST_ROOM[:2], north)
    assert worker.compute_values(WEST_ROOM[0])[0] == pytest.approx(0.5 * 0.9 * 20.0)


def test_unknown_steps_are_hoped_for_and_known_ones_weighed():
    agent = make(FourRooms(None), gamma=0.9, visits=2, optimistic_value=10.0)
    room, north, west = meet(agent, [WEST_ROOM[0], WEST_ROOM[3], WEST_ROOM[4]])
    for _ in range(2):
        agent._model(room, north, 3.0, 0.0, north)
    agent._model(room, west, 3.0, 0.5, west)
    values = agent.compute_step_values(room, 10.0)
    assert (values[north], values[west], values[-1]) == (3.0, 10.0, 10.0)
    agent._model(room, west, 3.0, 0.5, west)
    assert agent.compute_step_values(room, 10.0)[west] == pytest.approx(3 + 0.5 * 10)


@pytest.mark.nightly
def test_it_keeps_the_contract_of_agents_with_networks_too():
    check_agent(DeepAbstractQ, DeepAbstractQ.Settings(patience=9, visits=2, most_states=5), decisions=100)
