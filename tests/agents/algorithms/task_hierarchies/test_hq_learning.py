"""HQ-learning's backups by hand, and a maze that no reactive policy can solve and a sequence of two can."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.hq_learning import HqLearning
from hrl_escape.agents.training.evaluation import evaluate
from tests.agents.running import learn
from tests.classic.exact import find_fewest_primitives
from tests.classic.winding_maze import WindingMaze

ALL = np.ones(4, np.bool_)
SOLVES = 2
"""A seed that ends with a sequence of two policies that arrives."""


def make(env, seed=0, **settings):
    return HqLearning(env.observation_space, env.action_space, seed, HqLearning.Settings(**settings))


def find_fewest_by_sequence(env, agents):
    """Fewest primitives of any sequence of so many reactive policies, by depth-first search; None where none arrives.

    Policies and subgoals are laid down where they are first needed, so that all are tried.
    """
    best = [10**6]

    def walk(state, agent, length, policies, subgoals, seen, visited):
        if length >= best[0] or (state, agent) in visited:
            return
        observed = env.observe(state)
        actions = [policies[agent, observed]] if (agent, observed) in policies else range(4)
        for action in actions:
            ((_, there, _, ended),) = env.outcomes(state, action)
            laid = policies | {(agent, observed): action}
            if ended:
                best[0] = min(best[0], length + 1)
                continue
            after, trail = env.observe(there), visited | {(state, agent)}
            may_hand_over = agent + 1 < agents and after not in seen and agent not in subgoals
            if may_hand_over:
                walk(there, agent + 1, length + 1, laid, subgoals | {agent: after}, frozenset(), trail)
            walk(there, agent, length + 1, laid, subgoals, seen | {after}, trail)

    walk(int(env.make_starts().argmax()), 0, 0, {}, {}, frozenset(), frozenset())
    return None if best[0] == 10**6 else best[0]


@pytest.mark.parametrize("turns", [1, 2])
def test_the_maze_takes_one_reactive_policy_more_than_it_has_turns(turns):
    env = WindingMaze(turns)
    fewest = int(find_fewest_primitives(env.make_tables()) @ env.make_starts())
    assert find_fewest_by_sequence(env, turns) is None
    assert find_fewest_by_sequence(env, turns + 1) == fewest == 4 + 6 * turns


def play_by_hand(agent, steps, monkeypatch):
    """Observations, actions and rewards of one trial; the first agent's subgoal is observation 2."""
    subgoals = iter([2, 3])
    original = HqLearning._take_over

    def take_over(self, number, rng):
        if number == self.last:
            return original(self, number, rng)
        return original(self, number, rng)._replace(subgoal=self._discretise(next(subgoals)))

    monkeypatch.setattr(HqLearning, "_take_over", take_over)
    for observed, action, reward, after, terminated, truncated in steps:
        agent.act(observed, ALL)
        agent.observe(make_transition(observed, action, ALL, (after, reward, terminated, truncated, {}), agent.gamma))


BY_HAND = {"gamma": 0.9, "learning_rate": 1.0, "subgoal_learning_rate": 1.0, "trace": 0.5}
TRIAL = [(1, 0, 1.0, 1, False, False), (1, 1, 2.0, 2, False, False), (2, 2, 4.0, 4, False, False),
         (4, 3, 8.0, 0, True, False)]  # fmt: skip


def test_a_trial_teaches_values_of_primitives_and_of_the_subgoal_by_hand(monkeypatch):
    agent = make(WindingMaze(), agents=2, **BY_HAND)
    agent.tables[1].update(agent._discretise(2), 0, 20.0)
    agent.tables[0].update(agent._discretise(2), 0, 1000.0)
    play_by_hand(agent, TRIAL, monkeypatch)
    first, second = (table.get_values for table in agent.tables)
    key = agent._discretise
    assert second(key(4))[3] == pytest.approx(8.0)
    assert second(key(2))[2] == pytest.approx(4 + 0.9 * (0.5 * 0 + 0.5 * 8)), "V of observation 4 was 0"
    arrived = 4 + 0.9 * 0.5 * 8
    assert first(key(1))[1] == pytest.approx(2 + 0.9 * (0.5 * 20 + 0.5 * arrived)), "V of who acts next, not its own"
    earned_after = 4 + 0.9 * 8
    assert agent.subgoals.get((0, key(2))) == pytest.approx(1 + 0.9 * 2 + 0.81 * earned_after)


def test_the_value_mixed_in_is_that_of_legal_primitives():
    agent = make(WindingMaze(), agents=1, gamma=0.9, learning_rate=1.0, trace=0.5)
    agent.tables[0].update(agent._discretise(2), 3, 1000.0)
    forbidden = np.array([True, True, True, False])
    for observed, mask, after, terminated in ((1, ALL, 2, False), (2, forbidden, 0, True)):
        action = agent.act(observed, mask)
        step = (after, 4.0, terminated, False, {"action_mask": forbidden})
        agent.observe(make_transition(observed, action, mask, step, agent.gamma))
    assert agent.tables[0].get_values(agent._discretise(1)).max() == pytest.approx(4 + 0.9 * 0.5 * 4)


def test_between_agents_with_subgoals_the_best_one_is_mixed_in(monkeypatch):
    agent = make(WindingMaze(), agents=3, **BY_HAND)
    key = agent._discretise
    agent._met = [key(each) for each in (1, 2, 3)]
    agent.subgoals.update((1, key(1)), 50.0)
    play_by_hand(agent, TRIAL, monkeypatch)
    never_handed_over = 4 + 0.9 * 8
    assert agent.subgoals.get((1, key(3))) == pytest.approx(never_handed_over)
    expected = 1 + 0.9 * 2 + 0.81 * (0.5 * 50 + 0.5 * never_handed_over)
    assert agent.subgoals.get((0, key(2))) == pytest.approx(expected)


def test_a_trial_cut_by_the_time_limit_bootstraps_values_of_primitives_alone(monkeypatch):
    agent = make(WindingMaze(), agents=2, **BY_HAND)
    key = agent._discretise
    agent.tables[0].update(key(5), 0, 10.0)
    play_by_hand(agent, [(1, 1, 2.0, 5, False, True)], monkeypatch)
    assert agent.tables[0].get_values(key(1))[1] == pytest.approx(2 + 0.9 * 10)
    assert agent.subgoals.get((0, key(2))) == pytest.approx(2.0)


def test_a_subgoal_counts_after_a_primitive_only(monkeypatch):
    agent = make(WindingMaze(), agents=3, **BY_HAND)
    play_by_hand(agent, [(2, 0, 0.0, 1, False, False), (1, 0, 0.0, 2, False, False)], monkeypatch)
    assert agent._turn.agent == 1
    assert [begun for _, begun in agent._turns] == [0, 2], "not at its start, where it saw its subgoal already"
    agent.act(2, ALL)
    assert agent._turn.agent == 1


@pytest.mark.nightly
def test_two_agents_solve_the_maze_that_one_cannot():
    """Not every seed does: benchmarks/README.md counts them."""
    env = WindingMaze()
    settings = {"agents": 2, "gamma": 0.9, "learning_rate": 0.1, "subgoal_learning_rate": 0.02, "temperature": 1.0,
                "epsilon_start": 0.5, "epsilon_end": 0.1, "epsilon_steps": 20_000}  # fmt: skip
    agent = make(env, SOLVES, **settings)
    learn(agent, env, 20_000, SOLVES)
    evaluation = evaluate(agent, WindingMaze(horizon=60), 1)
    assert evaluation.success_rate == 1.0 and evaluation.mean_length == 10
