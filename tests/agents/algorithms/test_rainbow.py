"""Rainbow: its projection and targets against brute force, its parts one by one, and `dqn` with all of them off."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch

from hrl_escape.agents.algorithms.dqn import DQN
from hrl_escape.agents.algorithms.rainbow import Rainbow, RainbowSettings, project
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.networks import NoisyLinear
from hrl_escape.agents.components.replay import Experience, Priorities, Replay
from hrl_escape.agents.single_env import serve_one
from hrl_escape.errors import AgentSettingsError
from tests.agents.algorithms.test_deep_losses import ACTIONS, GAMMA, SIZE, SPACES, make_batch
from tests.agents.running import learn
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv, solve
from tests.agents.training.test_resuming import flatten

OFF = {"noise": 0.0, "dueling": False, "atoms": 1, "priority_exponent": 0.0}
SMALL = {"hidden": (16,), "batch_size": 8, "warmup": 20, "replay_capacity": 60}


def make(seed=0, **settings):
    return Rainbow(*SPACES, seed, RainbowSettings(gamma=GAMMA, hidden=(16,), reward_scale=1.0, **settings))


def project_by_hand(reward, bootstrap, shares, support):
    """Each atom moved and divided by distance, in plain loops."""
    out = np.zeros_like(shares)
    step = support[1] - support[0]
    for row, (r, b) in enumerate(zip(reward, bootstrap, strict=True)):
        for share, atom in zip(shares[row], support, strict=True):
            moved = min(max(r + b * atom, support[0]), support[-1])
            below = max(j for j in range(len(support)) if support[j] <= moved + 1e-9)
            part = (moved - support[below]) / step
            out[row, below] += share * (1 - part)
            if part > 1e-9:
                out[row, below + 1] += share * part
    return out


@pytest.mark.parametrize("seed", range(3))
def test_projection_is_that_of_brute_force_over_random_durations(seed):
    rng = np.random.default_rng(seed)
    support = np.linspace(-20, 10, 31)
    duration = rng.integers(1, 40, 50)
    reward, bootstrap = rng.uniform(-30, 15, 50), GAMMA**duration * (rng.random(50) > 0.2)
    reward[:10], bootstrap[:10] = rng.integers(-20, 11, 10), rng.integers(0, 2, 10)  # on the atoms themselves
    shares = rng.dirichlet(np.ones(31), 50)
    found = project(*map(torch.as_tensor, (reward, bootstrap, shares, support))).numpy()
    assert found == pytest.approx(project_by_hand(reward, bootstrap, shares, support), abs=1e-7)
    assert found.sum(axis=1) == pytest.approx(np.ones(50))
    inside = (reward + bootstrap * -20 >= -20) & (reward + bootstrap * 10 <= 10)
    assert inside.any()
    mean = reward + bootstrap * (shares @ support)
    assert (found @ support)[inside] == pytest.approx(mean[inside], abs=1e-6), "inside the support the mean is kept"


@pytest.mark.parametrize("double", [True, False])
def test_targets_are_projected_distributions_of_the_best_legal_action(double):
    batch, *_ = make_batch(0)
    agent = make(double=double, lowest_return=-3.0, highest_return=3.0, noise=0.0)
    with torch.no_grad():
        agent.values.target.weights += 0.3 * torch.randn(len(agent.values.target.weights),
                                                         generator=torch.Generator().manual_seed(1))
        found = agent.compute_targets(Experience(*map(torch.as_tensor, batch))).numpy()
        after = torch.as_tensor(batch.next_observation)
        target, online = agent.values.target[0], agent.values.online[0]
        shares = target.compute_logits(after).softmax(dim=2).double().numpy()
        chooser = (online if double else target).compute_logits(after).softmax(dim=2).double().numpy()
    support = np.linspace(-3, 3, 51)
    best = np.where(batch.next_mask, chooser @ support, -np.inf).argmax(axis=1)
    expected = project_by_hand(batch.reward, batch.bootstrap, shares[np.arange(SIZE), best], support)
    assert found == pytest.approx(expected, abs=2e-4)


def test_with_every_part_off_it_is_dqn_to_the_bit():
    states = []
    for agent_class, more in ((DQN, {}), (Rainbow, OFF)):
        env = ButtonGrid(trace=True, horizon=40)
        agent = agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**SMALL, **more))
        learn(agent, env, 150)
        assert agent.values.learner.updates > 20
        states.append(flatten(agent.state_dict()))
    dqn, rainbow = states
    assert {key: rainbow[key] for key in dqn} == dqn


@pytest.mark.nightly_for("noise-0.5", "atoms-11", "dueling-True")
@pytest.mark.parametrize(("part", "value"), [
    ("noise", 0.5), ("dueling", True), ("atoms", 11), ("priority_exponent", 0.5)])
def test_each_part_is_a_setting_of_its_own(part, value):
    env = ButtonGrid(trace=True, horizon=40)
    agent = Rainbow(env.observation_space, env.action_space, 0, RainbowSettings(**SMALL, **OFF | {part: value}))
    learn(agent, env, 100)
    layers = agent.values.online[0]
    parts = {"noise": any(isinstance(each, NoisyLinear) for each in agent.values.online.modules()),
             "dueling": getattr(layers, "state", None) is not None,
             "atoms": len(getattr(layers, "support", [0])) > 1, "priority_exponent": agent._priorities._seen > 0}
    assert [name for name, is_there in parts.items() if is_there] == [part]


PATH = tuple(
    ((Outcome(1.0, state + 1, (-1.0,) * 4),), (Outcome(1.0, state, (-1.0,)),), (Outcome(1.0, 0, (-1.0,) * 30),))
    for state in range(3)
) + ((*[(Outcome(1.0, 3, (-1.0, 100.0), True),)] * 2, (Outcome(1.0, 0, (-1.0,) * 30),)),)
"""Four decisions of rewards of -1 to an exit of 100; one choice stays, one starts again after 30 primitives."""


def learn_path(**settings):
    """Values after 500 updates on a batch of all decisions."""
    env = SmdpEnv(PATH, one_hot=True)
    agent = Rainbow(env.observation_space, env.action_space, 0, RainbowSettings(
        gamma=0.9, hidden=(32,), learning_rate=1e-2, target_every=20, average_rate=0.05, noise=0.0, **settings))
    rows, all_legal = np.eye(4, dtype=np.float32), np.ones(3, np.bool_)
    decisions = [
        Experience(rows[state], all_legal, action, 0.1 * sum(0.9**i * r for i, r in enumerate(outcome.rewards)),
                   0.0 if outcome.terminated else 0.9 ** len(outcome.rewards), rows[outcome.next_state], all_legal)
        for state, row in enumerate(PATH) for action, (outcome,) in enumerate(row)]
    batch = Experience(*(np.array(field, np.int64 if name == "action" else None) for name, field in
                         zip(Experience._fields, zip(*decisions, strict=True), strict=True)))
    batch = batch._replace(reward=batch.reward.astype(np.float32), bootstrap=batch.bootstrap.astype(np.float32))
    for _ in range(500):
        agent.update(batch)
    return np.array([agent.compute_values(row) for row in rows])


@pytest.mark.nightly
def test_values_of_options_come_near_the_exact_ones_with_the_default_support():
    exact = solve(PATH, 0.9)
    assert learn_path() == pytest.approx(exact, abs=1.0)
    low, high = RainbowSettings(gamma=0.9).bounds
    assert low == pytest.approx(-10) and low <= exact.min() and exact.max() <= high
    assert RainbowSettings().bounds == pytest.approx((-100, 100))


@pytest.mark.nightly
def test_the_support_of_clipped_games_saturates_here():
    assert learn_path(lowest_return=-10.0, highest_return=10.0).max() < 11 < 40 < solve(PATH, 0.9).max()


def test_dueling_streams_meet_in_the_mean_of_advantages():
    layers = make(noise=0.0).values.online[0]
    rows = torch.from_numpy(make_batch(0)[0].observation)
    with torch.no_grad():
        assert torch.allclose(layers.compute_logits(rows).mean(dim=1), layers.state(layers.body(rows)), atol=1e-5)


@pytest.mark.nightly
def test_noise_has_the_deviation_of_its_equation_and_none_is_left_in_evaluation():
    agent = make(noise=0.7)
    layer = next(each for each in agent.values.online.modules() if isinstance(each, NoisyLinear))
    rows, generator = torch.randn(1, layer.mean.in_features, generator=torch.Generator().manual_seed(0)), (
        torch.Generator().manual_seed(1))
    drawn = []
    with torch.no_grad():
        for _ in range(4_000):
            layer.draw(generator)
            drawn.append(layer(rows))
        layer.draw(None)
        spread = torch.cat(drawn).var(dim=0).numpy()
        # f(e) has mean 0 and E f(e)^2 = E|e| = sqrt(2 / pi)
        size, unit = 0.7**2 / layer.mean.in_features, np.sqrt(2 / np.pi)
        expected = size * (unit**2 * float((rows**2).sum()) + unit)
        assert spread == pytest.approx(np.full(len(spread), expected), rel=0.15)
        assert torch.cat(drawn).mean(dim=0).numpy() == pytest.approx(layer.mean(rows)[0].numpy(), abs=0.05)
    seen, mask = make_batch(0)[0].observation[0], np.ones(ACTIONS, np.bool_)
    before = agent.compute_values(seen)
    chosen = {serve_one(agent).act(seen, mask) for _ in range(50)}
    assert len(chosen) > 1, "noise explores"
    assert (agent.compute_values(seen) == before).all()
    assert not any(each._outs.any() for each in agent.values.online.modules() if isinstance(each, NoisyLinear))


def test_rows_are_drawn_by_their_powers_and_weights_undo_it():
    rng = np.random.default_rng(0)
    ring, priorities = Replay(Arrays(rng), 4, (1,), np.float32, 1), Priorities(0.5)
    one = Experience(*(np.zeros((1, *shape)) for shape in ((1,), (1,), (), (), (), (1,), (1,))))
    for _ in range(3):
        ring.add(one)
    rows, weights = priorities.draw(ring, 6_000, 1.0, rng)
    assert np.bincount(rows) / 6_000 == pytest.approx([1 / 3] * 3, abs=0.03) and (weights == 1).all()
    priorities.set(np.array([0, 1, 2]), np.array([1.0, 4.0, 16.0]))
    ring.add(one)  # as likely as the largest
    rows, weights = priorities.draw(ring, 20_000, 1.0, rng)
    assert np.bincount(rows) / 20_000 == pytest.approx(np.array([1, 2, 4, 4]) / 11, abs=0.015)
    total = np.bincount(rows, weights)
    assert total / total.sum() == pytest.approx([0.25] * 4, abs=0.02), "weighted, every row counts the same"
    ring.add(one)  # over the oldest
    assert np.bincount(priorities.draw(ring, 20_000, 0.0, rng)[0]) / 20_000 == pytest.approx(
        np.array([4, 2, 4, 4]) / 14, abs=0.015)


def test_what_does_not_go_together_is_refused():
    refused = partial(pytest.raises, AgentSettingsError)
    with refused(match="gamma = 1 gives none"):
        RainbowSettings(gamma=1.0)
    with refused(match="below highest_return = 5"):
        RainbowSettings(lowest_return=5.0, highest_return=5.0)
    with refused(match="mlp of at least one hidden layer"):
        RainbowSettings(network="objects")
    assert RainbowSettings(network="objects", **OFF) == RainbowSettings(network="objects", gamma=0.99, **OFF)
    with refused(match="none, with dueling, atoms or noise"):
        Rainbow(*SPACES, 0, network=torch.nn.Linear(5, 4))
