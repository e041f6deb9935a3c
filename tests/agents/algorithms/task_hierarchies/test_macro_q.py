"""Macro-Q learns the exact values of the SMDP that macros induce; its random walks last as long as solved exactly."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.macro_q import Macro, MacroQ
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.checks import check_agent
from tests.agents.hierarchy.wall_macros import make_wall_macros
from tests.agents.running import learn
from tests.classic.empty_room import CENTRE, CORNER, EDGE, GRID, EmptyRoom, make_macros
from tests.classic.exact import compute_choice_values, find_values, make_option_model, make_primitive_options
from tests.classic.tabular import State

ALL = np.ones(4, np.bool_)
EXACT = {"gamma": 0.9, "learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0}


def make(env, macros=True, seed=0, agent_class=MacroQ, **settings):
    chosen = MacroQ.Settings(**EXACT | settings)
    return agent_class(env.observation_space, env.action_space, seed, chosen, make_wall_macros() if macros else ())


def run_choice(agent, env, cell, choice):
    """Primitives that a choice takes from a cell, where it ends, and whether the episode ended on the way."""
    agent.choose = lambda stack, view, legal, seen: choice if len(stack) == 1 else int(legal.argmax())
    env.set_state(State(cell))
    for primitives in range(1, 100):
        action = agent.act(cell, ALL)
        transition = make_transition(cell, action, ALL, env.step(action), agent.gamma)
        agent.observe(transition)
        cell = transition.next_observation
        if transition.terminated or len(agent.stack) <= 1:
            return primitives, cell, transition.terminated
    raise AssertionError("the choice never ends")


def walk_at_random(goal, past=False):
    """Expected primitives of uniform choices to a goal, mean over starts, by a linear solve over runs of each choice.

    `past`: macros run on past the goal, which ends decisions only.
    """
    env = EmptyRoom(None if past else goal, horizon=None)
    env.reset(seed=0)
    agent = make(env)
    cells = [cell for cell in range(len(GRID)) if cell != goal]
    prices, follow = np.zeros(len(GRID)), np.zeros((len(GRID), len(GRID)))
    for cell in cells:
        for choice in range(8):
            primitives, there, terminated = run_choice(agent, env, cell, choice)
            prices[cell] += primitives / 8
            follow[cell, there] += 0.0 if terminated or there == goal else 1 / 8
    return np.linalg.solve(np.eye(len(GRID)) - follow, prices)[cells].mean()


@pytest.mark.nightly
def test_random_walks_last_as_long_as_the_paper_s_room_makes_them():
    """Macros hurt where the goal is in the centre and help at the walls; ending inside a macro is worth most of all."""
    lengths = {goal: walk_at_random(goal) for goal in (CENTRE, EDGE, CORNER)}
    assert lengths[CENTRE] == pytest.approx(15_030.5, rel=1e-4)
    assert (lengths[EDGE], lengths[CORNER]) == (pytest.approx(82.98, rel=1e-4), pytest.approx(54.76, rel=1e-4))
    assert walk_at_random(CENTRE, past=True) == pytest.approx(3_317_424, rel=1e-4)


@pytest.mark.nightly
def test_every_primitive_and_macro_is_worth_its_exact_value():
    """It sees a macro's reward without discount, gamma^1 in place of gamma^k, and a maximum at the wrong state."""
    env = EmptyRoom(EDGE, horizon=None)
    agent = make(env)
    cells = [cell for cell in range(env.states) if cell != EDGE]
    for _ in range(4):
        for cell in cells:
            for choice in range(8):
                run_choice(agent, env, cell, choice)
    options = [*make_primitive_options(env.states, 4), *make_macros()]
    model = make_option_model(env.make_tables(), options, agent.gamma)
    exact = compute_choice_values(model, find_values(model))
    for cell in cells:
        assert agent.compute_choice_values(cell) == pytest.approx(exact[cell], abs=1e-9), cell


def test_a_macro_that_is_cut_goes_on_with_its_own_value():
    """By hand: 3 of the 5 primitives to the wall were run, and a better choice was open where it was cut."""
    env = EmptyRoom(None)
    agent = make(env)
    start, cut_at = GRID.numbers[5, 5], GRID.numbers[2, 5]
    agent.table.update(agent._discretise(cut_at), 4, 7.0)
    agent.table.update(agent._discretise(cut_at), 3, 100.0)
    agent.choose = lambda stack, view, legal, seen: 4 if len(stack) == 1 else int(legal.argmax())
    cell = start
    for number in range(3):
        there = GRID.move(cell, 0)
        assert agent.act(cell, ALL) == 0
        agent.observe(make_transition(cell, 0, ALL, (there, -1.0, False, number == 2, {}), agent.gamma))
        cell = there
    assert cell == cut_at
    expected = -1 - 0.9 - 0.81 + 0.729 * 7.0
    assert agent.compute_choice_values(start)[4] == pytest.approx(expected)


def test_a_cut_macro_that_could_not_begin_there_teaches_nothing():
    env = EmptyRoom(None)
    east = Macro("east from the west", 4, lambda seen: 3, lambda seen: False, lambda seen: seen.observation % 11 == 0)
    agent = MacroQ(env.observation_space, env.action_space, 0, MacroQ.Settings(**EXACT), [east])
    agent.choose = lambda stack, view, legal, seen: 4 if len(stack) == 1 else int(legal.argmax())
    agent.act(0, ALL)
    agent.observe(make_transition(0, 3, ALL, (1, 5.0, False, True, {}), 0.9))
    assert len(agent.table) == 0
    assert not agent.hierarchy.root.legal(agent.hierarchy.see(1, ALL), None)[4]


def test_a_macro_whose_primitive_becomes_illegal_is_over_and_bootstraps():
    env = EmptyRoom(None)
    agent = make(env)
    agent.table.update(agent._discretise(1), 0, 10.0)
    agent.choose = lambda stack, view, legal, seen: 7 if len(stack) == 1 else int(legal.argmax())
    agent.act(0, ALL)
    shut = {"action_mask": np.array([1, 1, 1, 0], np.int8)}
    agent.observe(make_transition(0, 3, ALL, (1, -1.0, False, False, shut), 0.9))
    assert agent.compute_choice_values(0)[7] == pytest.approx(-1 + 0.9 * 10)


@pytest.mark.nightly
def test_macros_speed_up_learning_where_they_lead():
    """Greedy success after 600 primitives, over 5 seeds: with the goal in a corner macros help, in the centre not."""

    def measure(goal, macros):
        env = EmptyRoom(goal, horizon=100)
        rates = []
        for seed in range(5):
            agent = make(env, macros, seed, epsilon_end=0.1, epsilon_steps=300, learning_rate=0.5)
            learn(agent, env, 600, seed)
            rates.append(evaluate(agent, env, 10, seed).success_rate)
        return float(np.mean(rates))

    assert measure(CORNER, True) > measure(CORNER, False) + 0.3
    assert measure(CENTRE, True) < measure(CENTRE, False)


class RunsFirstPrimitive(MacroQ):
    """With a macro that does primitive 0 until observations sum to an even number."""

    def __init__(self, observation_space, action_space, seed, settings=None):
        macro = Macro("run", int(action_space.n), lambda seen: 0, lambda seen: int(np.sum(seen.observation)) % 2 == 0)
        super().__init__(observation_space, action_space, seed, settings, [macro])


def test_with_macros_it_keeps_the_contract_of_agents_and_says_so():
    assert make(EmptyRoom()).privileges == ("macro-actions",)
    assert make(EmptyRoom(), macros=False).privileges == ()
    check_agent(RunsFirstPrimitive, MacroQ.Settings(), decisions=60)
