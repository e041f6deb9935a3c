"""The option keyboard: successor features against their linear equations, and chords against each skill alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.algorithms.task_hierarchies.option_keyboard import OptionKeyboard, make_chords
from hrl_escape.agents.hierarchy.goal_space import GoalSpace
from tests.agents.running import learn
from tests.agents.small_envs import CutEnv, make_random_smdp
from tests.classic.goal_grid import GoalGrid
from tests.classic.grid import Grid

GAMMA = 0.9
ROOM = Grid(["......", "......", "......"])
BUTTONS = (ROOM.numbers[1, 1], ROOM.numbers[1, 4], ROOM.numbers[2, 2])
EXACT = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0, "chord_epsilon": 1.0}


def make_space(cells):
    return GoalSpace(lambda cell: np.array([float(cell)]), np.array(cells, np.float64)[:, None])


def make(env, cells, **settings):
    return OptionKeyboard(env.observation_space, env.action_space, 0, OptionKeyboard.Settings(**EXACT | settings),
                          make_space(cells))


@cache
def learn_room():
    env = GoalGrid(ROOM, None, horizon=100)
    agent = make(env, BUTTONS)
    learn(agent, env, 6_000)
    return agent


def find_first_events(choose):
    """Discounted chance of each button to be the first touched, from each cell by a policy, (cells, buttons)."""
    cells = len(ROOM)
    follow, events = np.zeros((cells, cells)), np.zeros((cells, 3))
    for cell in range(cells):
        there = ROOM.move(cell, choose(cell))
        if there in BUTTONS and there != cell:
            events[cell, BUTTONS.index(there)] = 1.0
        else:
            follow[cell, there] = GAMMA
    return np.linalg.solve(np.eye(cells) - follow, events)


@pytest.mark.nightly
def test_successor_features_solve_their_equations_and_skills_take_the_shortest_way():
    agent = learn_room()
    for skill, button in enumerate(BUTTONS):
        own = np.array([agent.skills.get(np.int32(cell).tobytes())[skill] for cell in range(len(ROOM))])
        choices = own[:, :, skill].argmax(axis=1)
        exact = find_first_events(lambda cell, choices=choices: choices[cell])
        assert own[np.arange(len(ROOM)), choices] == pytest.approx(exact, abs=1e-9)
        best = np.zeros((len(ROOM), 4))  # value iteration for this event alone
        for _ in range(60):
            best = np.array([[1.0 if (there := ROOM.move(cell, action)) == button != cell else
                              0.0 if there in BUTTONS and there != cell else GAMMA * best[there].max()
                              for action in range(4)] for cell in range(len(ROOM))])
        assert own[:, :, skill] == pytest.approx(best, abs=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize("chord", [(-1, 1, 0), (-1, -1, 1), (0.2, 1, -1), (1, 1, 1)])
def test_a_chord_is_at_least_as_good_as_each_skill_everywhere(chord):
    """The theorem of generalised policy improvement, by exact evaluation of the policy that is played."""
    agent, weights = learn_room(), np.array(chord, np.float64)
    tables = [agent.skills.get(np.int32(cell).tobytes()) for cell in range(len(ROOM))]
    played = find_first_events(
        lambda cell: int(agent.skills.compute_chord(np.int32(cell).tobytes(), weights).argmax())) @ weights
    alone = np.array([[(table[skill, table[skill, :, skill].argmax()] @ weights) for skill in range(3)]
                      for table in tables])
    assert (played >= alone.max(axis=1) - 1e-9).all()
    if chord == (1, 1, 1):
        assert (played.sum() > alone.sum(axis=0) + 0.5).all(), "any button: better than each skill of one"


@pytest.mark.nightly
@pytest.mark.nightly_for("0")
@pytest.mark.parametrize("seed", range(2))
def test_options_of_several_primitives_discount_events_and_what_follows_by_their_length(seed):
    env = CutEnv(make_random_smdp(seed, states=4, actions=3, branches=1, longest=5), seed, 12)
    agent = make(env, (2,))
    learn(agent, env, 4_000)
    best = np.zeros(4)
    for _ in range(200):
        q = np.array([[max((GAMMA ** (len(o.rewards) - 1) * (1.0 if o.next_state == 2 != state else
                            GAMMA * best[o.next_state] * (not o.terminated)) for o in outcomes), default=0.0)
                       for outcomes in row] for state, row in enumerate(env.smdp)])
        best = q.max(axis=1)
    for state, row in enumerate(env.smdp):
        legal = [action for action, outcomes in enumerate(row) if outcomes and state != 2]
        found = agent.skills.get(np.int32(state).tobytes())[0, :, 0]
        assert found[legal] == pytest.approx(q[state, legal], abs=1e-9)


@pytest.mark.nightly
def test_the_player_learns_the_worth_of_chords():
    """The first button ends the task; the second lies on the straight way to it."""
    env = GoalGrid(ROOM, BUTTONS[0], horizon=60)
    agent = make(env, BUTTONS, chord_epsilon=0.0, learning_rate=0.5, epsilon_end=0.3, epsilon_steps=2_000)
    learn(agent, env, 6_000)
    far = ROOM.numbers[1, 5]
    values = agent.table.get_values(np.int32(far).tobytes())
    assert values.max() == pytest.approx(GAMMA**3, rel=0.05), "straight on, by the chord of the button on the way"
    assert values[0] <= GAMMA**5, "round it, for touching it would release the first button's chord"


def test_chords_by_default_are_each_event_each_alone_and_all():
    assert make_chords(2).tolist() == [[1, 0], [0, 1], [1, -1], [-1, 1], [1, 1]]
    assert make_chords(1).tolist() == [[1]]
    agent = OptionKeyboard(spaces.MultiBinary(2), spaces.Discrete(3), 0)
    assert len(agent.get_options()) == len(agent.chords) == 9
