"""Hindsight when decisions are drawn: goals of the same episode, with reward and end computed again."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.agent import GoalRule
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.goal_replay import GoalReplay, apply_rule
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Decisions
from hrl_escape.errors import AgentSettingsError, StepContractError

GAMMA, ENVS, FAR = 0.9, 3, 1e6
POINT = spaces.Box(-FAR, FAR, (1,), np.float32)
SPACE = spaces.Dict({"observation": POINT, "achieved_goal": POINT, "desired_goal": POINT})
RULE = GoalRule(lambda achieved, goal, _: -np.abs(achieved - goal)[..., 0],
                lambda achieved, goal, _: (np.abs(achieved - goal) < 0.5)[..., 0])


def make(capacity, device=None, rule=RULE):
    return GoalReplay(Arrays(np.random.default_rng(0), device), capacity, ObservationEncoder(SPACE, False), 1, ENVS,
                      rule, 4, 0.1)


def decide(before, after, goal, terminated, truncated, duration=1):
    """A decision of every environment, from point to point; rows are achieved goal, desired goal, observation."""
    count = len(before)
    rows = [torch.stack((point, goal, point), dim=1) for point in (before, after)]
    reward = -(after - goal).abs()
    none = torch.ones((count, 0), dtype=torch.bool)
    batch = Decisions(torch.arange(count), rows[0], none, before[:, None], reward, reward,
                      torch.full((count,), duration), torch.full((count,), GAMMA**duration), rows[1], none,
                      terminated, truncated)
    encoded = [torch.stack((point, goal), dim=1) for point in (before, after)]
    return batch, Experience(encoded[0], none, before[:, None], reward * 0.1, GAMMA * ~terminated, encoded[1], none)


@pytest.mark.parametrize("capacity", [3_000, 60])
def test_goals_come_from_the_same_episode_at_or_after_the_decision(capacity):
    rng, replay = np.random.default_rng(3), make(capacity, torch.device("cpu"))
    point = torch.arange(ENVS) * 1_000.0
    goal, episode, known = torch.full((ENVS,), -7.0), torch.zeros(ENVS, dtype=torch.int64), {}
    for step in range(70):
        after = point + 1
        dies, cut = (torch.from_numpy(rng.random(ENVS) < share) for share in (0.05, 0.1))
        batch, experience = decide(point, after, goal, dies, cut & ~dies)
        replay.add_decisions(batch, experience, experience.action)
        for env in range(ENVS):
            known[float(point[env])] = env, int(episode[env]), step, bool(dies[env])
        episode += dies | cut
        point = after
    drawn = replay.sample(4_000)
    ends = {}
    for _, (env, number, step, _) in known.items():
        ends[env, number] = max(step, ends.get((env, number), 0))
    replaced = finished = 0
    for before, goal_drawn, after, reward, bootstrap in zip(
            drawn.observation[:, 0].tolist(), drawn.observation[:, 1].tolist(), drawn.next_observation[:, 0].tolist(),
            drawn.reward.tolist(), drawn.bootstrap.tolist(), strict=True):
        env, number, step, dies = known[before]
        assert after == before + 1
        is_over = number < int(episode[env])
        finished += is_over
        if goal_drawn == -7.0:
            assert reward == pytest.approx(-0.1 * (after + 7)) and bootstrap == pytest.approx(GAMMA * (not dies))
            continue
        replaced += 1
        later = known[goal_drawn - 1]
        assert is_over and later[:2] == (env, number) and later[2] >= step, "a goal of another or an earlier episode"
        reached = abs(after - goal_drawn) < 0.5
        assert reward == pytest.approx(-0.1 * abs(after - goal_drawn), abs=1e-4)
        assert bootstrap == pytest.approx(0.0 if reached or dies else GAMMA)
    assert 0.75 < replaced / finished < 0.85
    assert len(replay) == min(capacity // ENVS, 70) * ENVS


def test_decisions_of_several_primitives_and_environments_without_goals_are_refused():
    some = torch.zeros(ENVS)
    no = torch.zeros(ENVS, dtype=torch.bool)
    batch, experience = decide(some, some + 1, some, no, no, duration=2)
    with pytest.raises(StepContractError, match="ran 2 primitives"):
        make(60).add_decisions(batch, experience, experience.action)
    with pytest.raises(AgentSettingsError, match="has no goals"):
        make(60, rule=None)


def test_a_rule_for_single_goals_is_called_row_by_row():
    achieved, desired = torch.tensor([[0.0], [1.0], [5.0]]), torch.ones((3, 1))
    single = lambda one, other, _: bool(np.linalg.norm(one - other) < 0.5)  # noqa: E731
    assert apply_rule(single, achieved, desired, torch.bool).tolist() == [False, True, False]
    assert apply_rule(RULE.compute_terminated, achieved, desired, torch.bool).tolist() == [False, True, False]
