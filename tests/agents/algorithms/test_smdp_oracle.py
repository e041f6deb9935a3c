"""Targets of `dqn` and advantages of `ppo` against sums over primitives, in one environment and in many.

Decisions have random durations, rewards, masks and ends. The expected numbers are computed in float64 by NumPy, from
the primitives' rewards and the networks' weights.
"""

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.algorithms.ppo import PPO, PPOSettings
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.single_env import serve_one
from tests.agents.algorithms.test_deep_losses import forward

GAMMA, ACTIONS, SIZE = 0.93, 5, 3
SPACES = gymnasium.spaces.Box(-1, 1, (SIZE,), np.float32), gymnasium.spaces.Discrete(ACTIONS)
SETTINGS = {"gamma": GAMMA, "hidden": (8,), "scale_observations": False, "reward_scale": 0.5}
COUNTS = [(1, 60), (64, 9), (4_096, 3)]


class Life:
    """Decisions of one environment; a decision begins where the one before ended, unless the episode was over."""

    def __init__(self, rng, length):
        self.rng, self.decisions, self.length = rng, [], length
        self.seen, self.mask = self._see(), self._allow()

    def _see(self):
        return self.rng.standard_normal(SIZE).astype(np.float32)

    def _allow(self):
        mask = self.rng.random(ACTIONS) < 0.5
        mask[self.rng.integers(ACTIONS)] = True
        return mask

    def decide(self, action):
        assert self.mask[action], "an illegal action"
        rewards = self.rng.standard_normal(self.rng.integers(1, 13))
        end = self.rng.choice(["", "terminated", "truncated"], p=[0.8, 0.1, 0.1])
        made = SMDPTransition(self.seen, int(action), self.mask, sum(GAMMA**i * r for i, r in enumerate(rewards)),
                              float(rewards.sum()), len(rewards), GAMMA ** len(rewards), self._see(), self._allow(),
                              end == "terminated", end == "truncated")
        self.decisions.append((made, rewards))
        is_over = made.terminated or made.truncated
        self.seen, self.mask = (self._see(), self._allow()) if is_over else (made.next_observation,
                                                                            made.next_action_mask)
        return made

    def join(self, first, n):
        """R and gamma^k of up to n decisions from the first, primitive by primitive, and the last of them."""
        total, weight = 0.0, 1.0
        for made, rewards in self.decisions[first : first + n]:
            for reward in rewards:
                total, weight = total + weight * reward, weight * GAMMA
            if made.terminated or made.truncated:
                break
        return total, 0.0 if made.terminated else weight, made


def stack(rows, name, dtype=None):
    return torch.from_numpy(np.array([getattr(row, name) for row in rows], dtype))


def live(agent, count, length):
    """Let an agent decide in lives that take turns at random; returns them, and (life, place) in the order of ends."""
    rng = np.random.default_rng(count)
    lives, order = [Life(rng, length) for _ in range(count)], []
    if count == 1:
        served = serve_one(agent)
        for place in range(length):
            served.observe(lives[0].decide(served.act(lives[0].seen, lives[0].mask)))
            order.append((lives[0], place))
        return lives, order
    agent.begin_episodes(count, torch.device("cpu"))
    while rows := [at for at, life in enumerate(lives) if len(life.decisions) < length]:
        rows = rng.permutation(rows)[: rng.integers(1, len(rows) + 1)]
        env = torch.from_numpy(rows)
        asked = [lives[at] for at in rows]
        action = agent.act(Moments(env, stack(asked, "seen"), stack(asked, "mask")))
        made = [life.decide(int(each)) for life, each in zip(asked, action, strict=True)]
        order += [(life, len(life.decisions) - 1) for life in asked]
        f32, i64 = np.float32, np.int64
        agent.observe(Decisions(
            env, stack(made, "observation"), stack(made, "action_mask"), stack(made, "action", i64),
            stack(made, "reward", f32), stack(made, "summed_reward", f32), stack(made, "duration", i64),
            stack(made, "discount", f32), stack(made, "next_observation"), stack(made, "next_action_mask"),
            stack(made, "terminated"), stack(made, "truncated")))
    return lives, order


@pytest.mark.nightly_for("3-False-4096-3", "1-True-4096-3")
@pytest.mark.parametrize(("count", "length"), COUNTS)
@pytest.mark.parametrize(("n", "double"), [(1, True), (3, False)])
def test_targets_of_dqn_are_sums_over_primitives_and_the_best_legal_action(count, length, n, double):
    agent = DQN(*SPACES, 0, DQNSettings(**SETTINGS, n_step=n, double=double, warmup=10**9, replay_per_env=length))
    agent.values.target.weights.add_(0.3 * torch.randn(len(agent.values.target.weights),
                                                       generator=torch.Generator().manual_seed(1)))
    _, order = live(agent, count, length)
    assert len(agent.replay) == len(order)
    rows = np.arange(len(order)) if count == 1 else torch.arange(len(order))
    batch = Experience(*map(torch.as_tensor, agent.replay.take(rows)))
    found = agent.compute_targets(batch).detach().numpy()
    joined = [life.join(place, n) for life, place in order]
    after = np.array([made.next_observation for *_, made in joined], np.float64)
    legal = np.array([made.next_action_mask for *_, made in joined])
    target, online = (forward(network, after) for network in (agent.values.target, agent.values.online))
    best = np.where(legal, online if double else target, -np.inf).argmax(axis=1)
    expected = [0.5 * total + bootstrap * value for (total, bootstrap, _), value in
                zip(joined, target[np.arange(len(best)), best], strict=True)]
    assert found == pytest.approx(np.array(expected), abs=2e-5)
    assert batch.action.tolist() == [life.decisions[place][0].action for life, place in order]
    assert (batch.mask.numpy() == [life.decisions[place][0].action_mask for life, place in order]).all()


@pytest.mark.nightly_for("decision-4096-3", "primitive-4096-3")
@pytest.mark.parametrize(("count", "length"), COUNTS)
@pytest.mark.parametrize("lambda_per", ["decision", "primitive"])
def test_advantages_of_ppo_are_discounted_sums_of_errors_and_chances_are_those_of_the_choice(count, length, lambda_per):
    total = count * length
    agent = PPO(*SPACES, 0, PPOSettings(
        **SETTINGS, gae_lambda=0.8, lambda_per=lambda_per, rollout=total, rollout_per_env=1, batch_size=total,
        epochs=1))
    agent.policy.weights.mul_(20.0)  # far from uniform
    policy, critic = ([(each.weight.detach().clone(), each.bias.detach().clone()) for each in network
                       if isinstance(each, torch.nn.Linear)] for network in (agent.policy, agent.critic))
    told, compute_loss = [], agent.compute_loss
    agent.compute_loss = lambda *numbers: (told.append(numbers), compute_loss(*numbers))[1]
    lives, order = live(agent, count, length)
    (seen, mask, action, chance, advantage, target), = told  # one minibatch, shuffled
    assert len(seen) == total

    def run(layers, x):
        for weight, bias in layers[:-1]:
            x = np.tanh(x @ weight.double().numpy().T + bias.double().numpy())
        return x @ layers[-1][0].double().numpy().T + layers[-1][1].double().numpy()

    expected = {}
    for life in lives:
        observed = np.array([made.observation for made, _ in life.decisions], np.float64)
        values = run(critic, observed)[:, 0]
        reached = run(critic, np.array([made.next_observation for made, _ in life.decisions], np.float64))[:, 0]
        logits, carried = run(policy, observed), 0.0
        for place in reversed(range(length)):
            made, rewards = life.decisions[place]
            over = made.terminated or made.truncated
            power = len(rewards) if lambda_per == "primitive" else 1
            weight = 0.0 if made.terminated else GAMMA ** len(rewards)
            error = 0.5 * sum(GAMMA**i * r for i, r in enumerate(rewards)) + weight * reached[place] - values[place]
            carried = error + (0.0 if over else weight * 0.8**power * carried)
            shares = np.where(made.action_mask, np.exp(logits[place]), 0.0)
            expected[made.observation.tobytes()] = (
                made.action, np.log(shares[made.action] / shares.sum()), carried, carried + values[place])
    found = torch.stack([action.double(), chance.double(), advantage.double(), target.double()], dim=1).numpy()
    np.testing.assert_allclose(found, [expected[row.tobytes()] for row in seen.numpy()], rtol=1e-6, atol=2e-4)
    assert (mask.numpy()[np.arange(total), action.numpy()]).all()
