"""HIRO and HRAC: transitions of both levels along scripted runs, relabelled goals and adjacency by brute force."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.algorithms.continuous.hiro import Hiro, HiroSettings
from hrl_escape.agents.algorithms.continuous.hrac import Hrac
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.errors import AgentSettingsError

SEEN, ACTIONS = spaces.Box(-8.0, 8.0, (3,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32)
CPU, ENVS, WINDOW = torch.device("cpu"), 5, 4
SMALL = {"hidden": (16,), "window": WINDOW, "warmup": 0, "goal_range": (2.0, 3.0)}


def make(kind=Hiro, **settings):
    made = kind(SEEN, ACTIONS, 0, kind.Settings(**SMALL | settings))
    made.begin_episodes(ENVS, CPU)
    return made


def run(agent, steps=40, seed=0):
    """Let random outcomes follow an agent's choices; returns a record of each decision."""
    rng, none, rows = np.random.default_rng(seed), torch.ones((ENVS, 0), dtype=torch.bool), torch.arange(ENVS)
    seen = torch.from_numpy(rng.uniform(-4, 4, (ENVS, 3)).astype(np.float32))
    record = []
    for _ in range(steps):
        action = agent.act(Moments(rows, seen, none))
        goal = agent.windows.goal.clone()
        after = seen + torch.from_numpy(rng.uniform(-1, 1, (ENVS, 3)).astype(np.float32))
        duration = torch.from_numpy(rng.integers(1, 4, ENVS))
        terminated = torch.from_numpy(rng.random(ENVS) < 0.1)
        truncated = ~terminated & torch.from_numpy(rng.random(ENVS) < 0.1)
        reward, summed = torch.from_numpy(rng.normal(size=(2, ENVS)).astype(np.float32))
        discount = 0.99 ** duration.float()
        agent.observe(Decisions(rows, seen, none, action, reward, summed, duration, discount, after, none, terminated,
                                truncated))
        record.append((seen, action, goal, after, reward, summed, duration, terminated, truncated))
        over = (terminated | truncated)[:, None]
        fresh = torch.from_numpy(rng.uniform(-4, 4, (ENVS, 3)).astype(np.float32))
        seen = torch.where(over, fresh, after)
    return record


@pytest.mark.parametrize("discounting", ["decision", "primitive"])
def test_both_levels_store_what_happened_and_only_the_environment_pays_the_manager(discounting):
    agent = make(discounting=discounting, updates_per_step=0.0)
    record, scale = run(agent), torch.tensor([2.0, 3.0])
    worker, manager = agent.worker_replay.rows, agent.manager_replay.rows
    found, number = [], 0
    running = [None] * ENVS
    for seen, action, goal, after, reward, summed, duration, terminated, truncated in record:
        ended = []
        for env in range(ENVS):
            window = running[env]
            if window is None:
                window = running[env] = {"start": seen[env], "goal": goal[env], "reward": 0.0, "factor": 1.0,
                                         "length": 0}
            else:  # the same point of the room is aimed at until the window ends
                assert torch.allclose(goal[env] + seen[env][:2], window["goal"] + window["start"][:2], atol=1e-4)
            left = goal[env] + seen[env][:2] - after[env][:2]
            row = ENVS * number + env
            assert worker["reward"][row].item() == pytest.approx(-(left / scale).norm().item(), rel=1e-4)
            assert torch.allclose(worker["next_seen"][row, 3:], left / scale, atol=1e-4)
            assert torch.allclose(worker["action"][row], action[env], atol=1e-6)
            bootstrap = 0.0 if terminated[env] else 0.95 ** int(duration[env])
            assert worker["bootstrap"][row].item() == pytest.approx(bootstrap), "windows do not end the worker's task"
            is_sum = discounting == "decision"
            window["reward"] += (1.0 if is_sum else window["factor"]) * float((summed if is_sum else reward)[env])
            window["factor"] *= 1.0 if is_sum else 0.99 ** int(duration[env])
            window["length"] += 1
            if window["length"] == WINDOW or terminated[env] or truncated[env]:
                factor = 0.99 if is_sum else window["factor"]
                ended.append((window, after[env], 0.0 if terminated[env] else factor))
                running[env] = None
        found += ended
        number += 1
    assert len(agent.manager_replay) == len(found) > 40
    for row, (window, after, bootstrap) in enumerate(found):
        assert torch.allclose(manager["seen"][row] * 8, window["start"], atol=1e-4)
        assert torch.allclose(manager["goal"][row], window["goal"], atol=1e-4)
        assert manager["reward"][row].item() == pytest.approx(0.1 * window["reward"], abs=1e-4)
        assert manager["bootstrap"][row].item() == pytest.approx(bootstrap)
        assert torch.allclose(manager["next_seen"][row] * 8, after, atol=1e-4)
        assert manager["length"][row] == window["length"]


def test_targets_of_both_levels_are_exact_along_scripted_windows():
    agent = make(updates_per_step=0.0, target_noise=0.0, correction=False)
    record, scale = run(agent), torch.tensor([2.0, 3.0])
    drift = torch.Generator().manual_seed(3)
    for level in (agent.worker, agent.manager):  # targets that differ from each other and from the online networks
        for network in (level.target_actor, *level.target_critics):
            network.weights.add_(0.3 * torch.randn(network.weights.shape, generator=drift))

    def value(level, seen):
        pair = torch.cat((seen, level.target_actor(seen[None])[0].tanh()))
        return min(critic(pair[None]).item() for critic in level.target_critics)

    for level, replay in ((agent.worker, agent.worker_replay), (agent.manager, agent.manager_replay)):
        rows = {name: each[: len(replay)] for name, each in replay.rows.items()}
        level.found = level.compute_targets(rows["reward"], rows["bootstrap"], rows["next_seen"]).tolist()
    starts, number = [None] * ENVS, 0
    for step, (seen, _, goal, after, _, summed, duration, terminated, truncated) in enumerate(record):
        for env in range(ENVS):
            # The worker is paid for the distance to its goal, and valued for the same point after the move, also where
            # its window ends.
            left = goal[env] + seen[env][:2] - after[env][:2]
            future = value(agent.worker, torch.cat((after[env] / 8, left / scale)))
            factor = 0.0 if terminated[env] else 0.95 ** int(duration[env])
            exact = -float((left / scale).norm()) + factor * future
            assert agent.worker.found[ENVS * step + env] == pytest.approx(exact, abs=1e-3)
            starts[env] = starts[env] or [0, 0.0]
            starts[env] = [starts[env][0] + 1, starts[env][1] + float(summed[env])]
            if starts[env][0] == WINDOW or terminated[env] or truncated[env]:
                future = 0.0 if terminated[env] else value(agent.manager, after[env] / 8)
                exact = 0.1 * starts[env][1] + 0.99 * future
                assert agent.manager.found[number] == pytest.approx(exact, abs=1e-3)
                number, starts[env] = number + 1, None
    assert number == len(agent.manager_replay) > 40


def test_old_goals_become_the_candidates_that_make_the_actions_likeliest():
    agent = make(updates_per_step=0.0)
    run(agent)
    agent.worker.actor.weights.mul_(2.0)
    drawn = agent.manager_replay.sample(60)
    candidates = torch.randn((60, 3, 2))
    found = agent.compute_likelihoods(drawn, candidates)
    for row in range(60):
        for each in range(3):
            total = 0.0
            for step in range(int(drawn["length"][row])):
                goal = candidates[row, each] + drawn["points"][row, 0] - drawn["points"][row, step]
                chosen = agent.worker.evaluate(agent.join(drawn["views"][row, step], goal)[None])[0]
                total -= 0.5 * float(((chosen - drawn["actions"][row, step]) ** 2).sum())
            assert found[row, each].item() == pytest.approx(total, abs=1e-3)
    relabelled = agent.relabel(drawn)
    pair = torch.stack((relabelled, drawn["goal"]), dim=1)
    better = agent.compute_likelihoods(drawn, pair)
    assert (better[:, 0] >= better[:, 1] - 1e-5).all() and (relabelled != drawn["goal"]).any()
    assert (relabelled.abs() <= agent.goals.range + 1e-5).all()


def test_the_greedy_policy_advances_its_goal_and_sets_a_new_one_every_window():
    agent, rng = make(), np.random.default_rng(5)
    policy = agent.make_policy()
    policy.begin_episode(rng)
    targets = []
    for _ in range(3 * WINDOW):
        seen = rng.uniform(-4, 4, 3).astype(np.float32)
        assert ACTIONS.contains(policy.choose(seen, np.ones(0, bool)))
        targets.append(agent.list_calls()[0].place)
    spread = [np.ptp(np.array(targets[first:first + WINDOW]), axis=0).max() for first in range(0, 3 * WINDOW, WINDOW)]
    assert max(spread) < 1e-4 and np.ptp(np.array(targets), axis=0).max() > 0.1


def test_adjacent_points_are_those_of_one_window_and_the_penalty_begins_at_the_radius():
    agent = make(Hrac, updates_per_step=0.0, adjacency_bins=16)
    record = run(agent, 30)
    expected = set()
    for env in range(ENVS):
        window = []
        for seen, _, _, after, _, _, _, terminated, truncated in record:
            window = window or [seen[env, :2]]
            window.append(after[env, :2])
            if len(window) == WINDOW + 1 or terminated[env] or truncated[env]:
                cells = [int(agent.find_cells(point)) for point in window]
                expected |= {(one, other) for one in cells for other in cells}
                window = []
    assert {tuple(pair) for pair in agent.is_adjacent.nonzero().tolist()} == expected
    first, second = torch.randint(256, (2, 200), generator=torch.Generator().manual_seed(0))
    first[:50], second[:50] = torch.tensor(list(expected))[:50].T
    losses = []
    for one, other in zip(first.tolist(), second.tolist(), strict=True):
        points = [agent.psi(agent.find_centres(torch.tensor([cell])))[0] for cell in (one, other)]
        distance = float((points[0] - points[1]).norm().detach())
        losses.append(max(distance - 1, 0) if (one, other) in expected else max(1.2 - distance, 0))
    assert agent.compute_adjacency_loss(first, second).item() == pytest.approx(np.mean(losses), abs=1e-4)
    penalise = agent.find_penalty(agent.manager_replay.sample(8))
    assert penalise(torch.zeros(8, 2)).item() == 0.0
    agent.psi.weights.mul_(100.0)
    assert penalise(torch.ones(8, 2)).item() > 0.0


def test_goals_without_bounds_and_wrong_columns_are_refused():
    for columns, space, message in (((0, 1), spaces.Box(-np.inf, np.inf, (3,)), "have no finite bounds"),
                                    ((0, 7), SEEN, "components from 0 to 2")):
        with pytest.raises(AgentSettingsError, match=message):
            Hiro(space, ACTIONS, 0, HiroSettings(goal_columns=columns))
