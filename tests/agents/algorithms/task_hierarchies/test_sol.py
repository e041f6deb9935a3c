"""SOL: V-trace over each policy's own choices against brute force, what options are paid, what choosing costs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.task_hierarchies.sol import Choices, Sol, compute_vtrace
from hrl_escape.agents.hierarchy.goal_space import GoalSpace
from tests.agents.running import interact, learn
from tests.agents.small_envs import Outcome, SmdpEnv

SIZE, GAMMA = 60, 0.9
ROW = SmdpEnv(tuple(((Outcome(1.0, max(cell - 1, 0), (-1.0,)),), (Outcome(1.0, min(cell + 1, 4), (-1.0,)),))
                    for cell in range(5)), start=2, horizon=16)
"""Five cells in a row, left and right, from the middle one."""
ENDS = GoalSpace(lambda cell: np.array([float(cell)]), np.array([[0.0], [4.0]]))


def make(seed=0, **settings):
    chosen = {"hidden": (16,), "gamma": GAMMA, "longest": 4} | settings
    return Sol(ROW.observation_space, ROW.action_space, seed, Sol.Settings(**chosen), ENDS)


def make_choices(seed):
    """Random choices of three policies; episodes end with an option's choice and the controller's."""
    rng = np.random.default_rng(seed)
    policy, over = rng.integers(0, 3, SIZE), np.zeros(SIZE, np.bool_)
    for row in np.flatnonzero(rng.random(SIZE - 1) < 0.15):
        policy[row : row + 2] = rng.integers(1, 3), 0
        over[row : row + 2] = True
    over &= np.append(over[1:], False) | (policy == 0)  # an option's choice is over only with the controller's
    bootstrap = GAMMA ** rng.integers(1, 9, SIZE) * ~(over & (rng.random(SIZE) < 0.5))
    nothing = torch.zeros(SIZE)
    choices = Choices(nothing, torch.from_numpy(policy), nothing, nothing, nothing,
                      torch.from_numpy(rng.standard_normal(SIZE)), torch.from_numpy(bootstrap), torch.from_numpy(over),
                      nothing)
    return choices, *(torch.from_numpy(each) for each in (*rng.standard_normal((2, SIZE)), rng.uniform(0.2, 2, SIZE)))


def find_next(choices, row):
    """The next choice of the same policy before the episode is over, by looking forward."""
    for later in range(row, SIZE):
        if later > row and choices.policy[later] == choices.policy[row]:
            return later
        if choices.over[later] and choices.policy[later] == 0:
            return None
    return None


@pytest.mark.parametrize("seed", range(3))
def test_each_policy_is_chained_over_its_own_choices_within_its_episode(seed):
    choices, values, next_values, ratio = make_choices(seed)
    targets, advantages = compute_vtrace(choices, values, next_values, ratio, 1.0)

    def expand(row):
        """Target of a choice as the sum over those that follow (Espeholt et al. 2018, equation 1)."""
        total, weight, at = float(values[row]), 1.0, row
        while at is not None:
            after = find_next(choices, at)
            next_value = float(next_values[at] if after is None else values[after])
            rho = min(1.0, float(ratio[at]))
            delta = rho * (float(choices.reward[at]) + float(choices.bootstrap[at]) * next_value - float(values[at]))
            total += weight * delta
            weight *= rho * float(choices.bootstrap[at])
            at = after
        return total

    expected = np.array([expand(row) for row in range(SIZE)])
    assert targets.numpy() == pytest.approx(expected)
    for row in range(SIZE):
        after = find_next(choices, row)
        follow = float(next_values[row]) if after is None else expected[after]
        assert float(advantages[row]) == pytest.approx(min(1.0, float(ratio[row])) * (
            float(choices.reward[row]) + float(choices.bootstrap[row]) * follow - float(values[row])))


def walk(agent, option, cells, rewards):
    """The controller starts an option for two primitives, which go through the cells; returns the rows kept."""
    lengths, moves = 3, [1 if after > cell else 0 for cell, after in zip(cells, cells[1:], strict=False)]
    choices = [option * lengths + 1]  # the second length, 2
    agent.choose = lambda stack, *given: choices.pop() if stack[-1].context is None else moves.pop(0)
    both = np.ones(2, np.bool_)
    for cell, after, reward in zip(cells, cells[1:], rewards, strict=False):
        action = agent.act(cell, both)
        agent.observe(make_transition(cell, action, both, (after, reward, False, False, {}), GAMMA))
    return agent._rows


def test_a_choice_of_the_controller_costs_neither_primitives_nor_discount():
    *options, controller = walk(make(reward_scale=1.0), 0, [3, 2, 1], [5.0, 7.0])
    assert [row.policy for row in options] == [1, 1] and controller.policy == 0
    assert [row.bootstrap for row in options] == [GAMMA] * 2
    assert controller.bootstrap == pytest.approx(GAMMA**2)
    assert controller.reward == pytest.approx(5 + GAMMA * 7)


@pytest.mark.parametrize(("option", "cells", "expected"), [
    (0, [1, 0, 0], [1.0, 0.0]), (1, [1, 0, 0], [0.0, 0.0]), (1, [3, 4, 4], [1.0, 0.0]), (2, [1, 0, 0], [0.5, 0.7])])
def test_options_are_paid_for_their_own_event_and_the_last_one_for_the_task(option, cells, expected):
    rows = walk(make(), option, cells, [5.0, 7.0])
    assert [row.reward for row in rows[:2]] == pytest.approx(expected)
    assert {row.observation[5:].tolist()[option + 1] for row in rows[:2]} == {1.0}


def test_a_rollout_is_learned_from_at_the_probabilities_of_its_choices():
    agent = make(epochs=1, rollout=40)
    seen, compute_losses = [], agent.compute_losses
    agent.compute_losses = lambda choices: seen.append(choices) or compute_losses(choices)
    for _ in interact(agent, ROW, 40):
        if seen:
            break
    (choices,) = seen
    fresh = make(epochs=1)
    with torch.no_grad():
        log_policy, _ = fresh.compute_outputs(choices)
    assert log_policy.gather(1, choices.choice[:, None])[:, 0].numpy() == pytest.approx(
        choices.log_probability.numpy(), abs=1e-5), "in the first update every ratio is 1"


@pytest.mark.nightly
def test_each_option_learns_the_way_to_its_own_end():
    agent = make(learning_rate=1e-2)
    learn(agent, ROW, 2_500)
    for option, choice in ((0, 0), (1, 1)):
        told = torch.from_numpy(np.array([agent._see(cell, 1 + option) for cell in (1, 2, 3)]))
        assert agent.network(told)[:, :2].argmax(dim=1).tolist() == [choice] * 3
