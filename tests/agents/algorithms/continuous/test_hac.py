"""HAC: the transitions of every level against a plain record of scripted runs."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.algorithms.continuous.hac import INITIAL_COST, Hac, HacSettings, find_near
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError

POINT = spaces.Box(-2.0, 2.0, (2,), np.float32)
SPACE = spaces.Dict({"observation": POINT, "achieved_goal": POINT, "desired_goal": POINT})
ACTIONS = spaces.Box(-1.0, 1.0, (2,), np.float32)
ENVS, ATTEMPTS, NEAR = 4, 3, 0.9


def make(**settings):
    agent = Hac(SPACE, ACTIONS, 0, HacSettings(
        **{"attempts": ATTEMPTS, "hidden": (8,), "updates_per_step": 0.0, "goal_tolerance": NEAR} | settings))
    agent.begin_episodes(ENVS, torch.device("cpu"))
    return agent


def run(agent, steps, after_step):
    """Random points follow the choices; `after_step` gets what each decision was, before anything is learned of it."""
    rng, none, rows = np.random.default_rng(0), torch.ones((ENVS, 0), dtype=torch.bool), torch.arange(ENVS)

    def draw(scale=2.0):
        return torch.from_numpy(rng.uniform(-scale, scale, (ENVS, 2)).astype(np.float32))

    point, desired = draw(), draw()
    for _ in range(steps):
        seen = torch.cat((point, desired, point), dim=1)  # achieved_goal, desired_goal, observation
        action = agent.act(Moments(rows, seen, none))
        after = (point + draw(1.5)).clamp(-2, 2)
        terminated = (after - desired).norm(dim=1) <= NEAR
        truncated = ~terminated & torch.from_numpy(rng.random(ENVS) < 0.1)
        goals, tested = agent.calls.goal.clone(), agent._tested.clone()
        ones = torch.ones(ENVS)
        agent.observe(Decisions(rows, seen, none, action, -ones, -ones, ones.long(), 0.99 * ones,
                                torch.cat((after, desired, after), dim=1), none, terminated, truncated))
        after_step(point, action, after, goals, tested, terminated, truncated)
        over = (terminated | truncated)[:, None]
        point, desired = torch.where(over, draw(), after), torch.where(over, draw(), desired)


def list_rows(replay):
    rows = torch.cat([each[:len(replay)].reshape(len(replay), -1) for each in replay.rows.values()], dim=1)
    return sorted(tuple(np.round(row, 3) + 0.0) for row in rows.double().numpy())


def test_every_level_learns_in_hindsight_and_from_missed_tests():
    agent = make(hindsight_goals=0, subgoal_tests=0.5)
    low, high = [], []
    running = [None] * ENVS  # of the upper level: start, count of lower choices, count of upper choices
    tests = 0

    def note(point, action, after, goals, tested, terminated, truncated):
        nonlocal tests
        for env in range(ENVS):
            call = running[env] = running[env] or {"start": point[env], "lower": 0, "upper": 0}
            call["start"] = point[env] if call["lower"] == 0 else call["start"]
            hit_low, hit_top = ((after[env] - goals[level, env]).norm() <= NEAR for level in range(2))
            cut, hit_top = bool(terminated[env] | truncated[env]), bool(hit_top | terminated[env])

            def row(start, choice, goal, reward, bootstrap, env=env):
                parts = (start / 2, goal / 2, choice, torch.tensor([reward, bootstrap]), after[env] / 2, goal / 2)
                return tuple(np.round(torch.cat(parts).double().numpy(), 3) + 0.0)

            low.append(row(point[env], action[env], goals[0, env], float(hit_low) - 1, 0.0 if hit_low else 0.95))
            call["lower"] += 1
            if not (hit_low or hit_top or cut or call["lower"] == ATTEMPTS):
                continue
            choice = (goals[0, env] if hit_low else after[env]) / 2
            high.append(row(call["start"], choice, goals[1, env], float(hit_top) - 1, 0.0 if hit_top else 0.95))
            if tested[1, env] and not (hit_low or hit_top or cut):
                tests += 1
                high.append(row(call["start"], goals[0, env] / 2, goals[1, env], -float(ATTEMPTS), 0.0))
            call["lower"] = 0

    run(agent, 60, note)
    assert list_rows(agent.replays[0]) == sorted(low) and list_rows(agent.replays[1]) == sorted(high)
    assert tests > 5


def test_goals_in_hindsight_were_reached_later_in_the_same_call():
    agent = make(hindsight_goals=2, subgoal_tests=0.0)
    reached = [set() for _ in range(2)]

    def note(point, action, after, goals, tested, terminated, truncated):
        for each in (after, goals[0], goals[1]):
            reached[0] |= {tuple(np.round(row, 3)) for row in (each / 2).double().numpy()}

    run(agent, 60, note)
    for replay in agent.replays:
        rows = {name: each[:len(replay)] for name, each in replay.rows.items()}
        goal, there = rows["seen"][:, 2:] * 2, rows["next_seen"][:, :2] * 2
        hit = (goal - there).norm(dim=1) <= NEAR
        assert torch.equal(rows["seen"][:, 2:], rows["next_seen"][:, 2:])
        assert torch.equal(rows["reward"], hit.float() - 1)
        assert torch.equal(rows["bootstrap"] > 0, ~hit)
        assert {tuple(np.round(row, 3)) for row in rows["seen"][:, 2:].double().numpy()} <= reached[0]
        assert hit.float().mean() > 0.4


def test_values_are_between_minus_h_and_zero_and_nothing_explores_below_a_test():
    agent = make(subgoal_tests=1.0)
    seen = torch.randn(50, 4) * 100
    values = agent.levels[0].compute_values(seen, torch.randn(50, 2))
    assert (values <= 0).all() and (values >= -ATTEMPTS).all()
    untrained = agent.levels[1].compute_values(seen / 100, torch.zeros(50, 2))
    assert torch.allclose(untrained, torch.tensor(-INITIAL_COST), atol=0.05), "optimistic"

    def note(point, action, after, goals, tested, terminated, truncated):
        assert tested[1].all()
        with torch.no_grad():
            best = agent.levels[0].choose(agent.see(point / 2, goals[0]))
        assert torch.allclose(action, best, atol=1e-5)

    run(agent, 20, note)


def test_one_level_pursues_the_goal_of_the_environment():
    agent = make(levels=1, hindsight_goals=0, warmup=0)
    rows = []

    def note(point, action, after, goals, tested, terminated, truncated):
        assert goals.shape == (1, ENVS, 2) and not tested.any()
        for env in range(ENVS):
            hit = bool(terminated[env])  # `run` terminates within the same distance
            parts = (point[env] / 2, goals[0, env] / 2, action[env], torch.tensor([hit - 1.0, 0.95 * (not hit)]),
                     after[env] / 2, goals[0, env] / 2)
            rows.append(tuple(np.round(torch.cat(parts).double().numpy(), 3) + 0.0))

    run(agent, 30, note)
    assert list_rows(agent.replays[0]) == sorted(rows)
    assert len(agent.list_calls()) == 1


def test_levels_see_goals_as_they_see_observations():
    view, goal = torch.tensor([[0.5, -1.0]]), torch.tensor([[2.0, -1.0]])
    assert make().see(view, goal).tolist() == [[0.5, -1.0, 1.0, -0.5]]
    assert make(scale_observations=False).see(view, goal).tolist() == [[0.5, -1.0, 2.0, -1.0]]


def test_tolerances_of_components_make_a_box():
    differences = torch.tensor([[0.09, 1.9], [0.11, 0.0], [-0.09, -2.1], [-0.1, 2.0]])
    assert find_near(differences, HacSettings(goal_tolerances=(0.1, 2.0))).tolist() == [True, False, False, True]
    assert find_near(differences, HacSettings(goal_tolerance=2.0)).tolist() == [True, True, False, False]
    agent = make(goal_tolerances=(0.1, 2.0), hindsight_goals=1, subgoal_tests=0.0)
    run(agent, 60, lambda *parts: None)
    for replay in agent.replays:
        rows = {name: each[:len(replay)] for name, each in replay.rows.items()}
        there, goal = rows["next_seen"][:, :2] * 2, rows["seen"][:, 2:] * 2
        hit = ((goal - there).abs() <= torch.tensor([0.1, 2.0])).all(1)
        is_free = ~(((goal - there).norm(dim=1) <= NEAR) | hit)  # `run` terminates within NEAR
        assert (rows["reward"][hit] == 0).all() and (rows["reward"][is_free] == -1).all() and hit.any()
    with pytest.raises(AgentSettingsError, match=r"goal_tolerances.*2 numbers"):
        make(goal_tolerances=(0.1,))


def test_environments_without_goals_are_refused():
    with pytest.raises(UnsupportedSpaceError, match="desired_goal"):
        Hac(POINT, ACTIONS, 0)
