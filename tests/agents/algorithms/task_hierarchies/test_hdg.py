"""HDG learns exact distances in Four Rooms, and needs the neighbour rule not to walk in circles."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.hdg import Hdg, Landmarks
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.checks import check_agent
from hrl_escape.errors import AgentSettingsError
from tests.agents.running import learn
from tests.classic.four_rooms import GRID, HALLWAYS, FourRooms

ALL = np.ones(4, np.bool_)
CELLS = len(GRID)


def compute_distances():
    """Lengths of shortest ways, (cells, cells), by breadth-first search."""
    lengths = np.full((CELLS, CELLS), np.inf)
    for goal in range(CELLS):
        front, length = [goal], 0
        while front:
            lengths[front, goal] = length
            front = [n for n in {n for cell in front for n in GRID.list_neighbours(cell)} if lengths[n, goal] > 1e9]
            length += 1
    return lengths


EXACT = compute_distances()
LANDMARKS = Landmarks(HALLWAYS, lambda cell: int(EXACT[list(HALLWAYS), cell].argmin()))


def make(landmarks=LANDMARKS, **settings):
    env = FourRooms(None, "none")
    chosen = Hdg.Settings(epsilon_start=1.0, epsilon_end=1.0, **settings)
    return Hdg(env.observation_space, env.action_space, 0, chosen, landmarks, goal=lambda observation: 0)


def teach_everything(agent, sweeps):
    """Every action in every cell, in random order."""
    rng = np.random.default_rng(0)
    for _ in range(sweeps):
        for pair in rng.permutation(CELLS * 4):
            cell, action = divmod(int(pair), 4)
            step = (GRID.move(cell, action), -1.0, False, False, {})
            agent.observe(make_transition(cell, action, ALL, step, agent.gamma))
    return agent


def measure_walks(agent):
    """Length over the shortest of every walk that arrives, and how many do not."""
    number = [agent.number(cell) for cell in range(CELLS)]
    ratios, failures = [], 0
    moves = np.array([[GRID.move(cell, action) for action in range(4)] for cell in range(CELLS)])
    for goal in range(CELLS):
        actions = [
            0 if cell == goal else
            int(agent.distances[number[cell], agent.choose_target(number[cell], number[goal])].argmin())
            for cell in range(CELLS)
        ]  # fmt: skip
        following = moves[np.arange(CELLS), actions]
        for start in range(CELLS):
            cell, length = start, 0
            while cell != goal and length <= CELLS:
                cell, length = int(following[cell]), length + 1
            if cell != goal:
                failures += 1
            elif start != goal:
                ratios.append(length / EXACT[start, goal])
    return float(np.mean(ratios)), failures


@pytest.fixture(scope="module")
def taught():
    return teach_everything(make(learning_rate=1.0), 40)


@pytest.mark.nightly
def test_kept_distances_become_exact(taught):
    number = [taught.number(cell) for cell in range(CELLS)]
    for cell in range(CELLS):
        kept = taught._keeps(number[cell])
        for goal in range(CELLS):
            if kept[number[goal]] and goal != cell:
                assert taught.distances[number[cell], number[goal]].min() == EXACT[cell, goal], (cell, goal)


@pytest.mark.nightly
def test_with_the_neighbour_rule_every_walk_arrives_and_is_nearly_shortest(taught):
    ratio, failures = measure_walks(taught)
    assert failures == 0 and ratio == pytest.approx(1.0108, abs=1e-4)


@pytest.mark.nightly
def test_the_next_landmark_of_the_paper_is_that_of_the_region_and_makes_detours(taught):
    """It leads on from the landmark of the state's region, also where the state lies past it."""
    agent = make(next_landmark="from-landmark")
    agent.load_state_dict(taught.state_dict())
    ratio, failures = measure_walks(agent)
    assert failures == 0 and ratio == pytest.approx(1.0739, abs=1e-4)


@pytest.mark.nightly
def test_without_the_neighbour_rule_walks_turn_back_for_ever(taught):
    agent = make(neighbours=False)
    agent.load_state_dict(taught.state_dict())
    _, failures = measure_walks(agent)
    assert failures > 0.1 * CELLS * (CELLS - 1)


@pytest.mark.nightly
def test_without_landmarks_every_distance_is_learned_and_every_walk_is_shortest():
    agent = teach_everything(make(Landmarks((0,), lambda cell: 0), learning_rate=1.0), 40)
    assert measure_walks(agent) == (1.0, 0)


@pytest.mark.nightly
def test_it_finds_goals_by_itself_where_episodes_terminate():
    env = FourRooms(HALLWAYS[2], "none", horizon=200)
    settings = Hdg.Settings(learning_rate=1.0, epsilon_start=1.0, epsilon_end=0.1, epsilon_steps=5_000)
    agent = Hdg(env.observation_space, env.action_space, 0, settings)
    learn(agent, env, 12_000)
    evaluation = evaluate(agent, env, 100)
    assert evaluation.success_rate == 1.0
    assert evaluation.mean_length == pytest.approx(EXACT[:, HALLWAYS[2]].sum() / (CELLS - 1), abs=1.0)


def test_a_landmark_lies_in_its_own_region():
    with pytest.raises(AgentSettingsError, match="its own region"):
        Landmarks((0, 1), lambda state: 0)


def test_it_keeps_the_contract_of_agents():
    check_agent(Hdg, decisions=200)
