"""Deep losses against two references on random SMDP batches: numpy by hand, and TorchRL where it is right.

TorchRL's `DQNLoss` and `GAE` discount by gamma to the power of the root key `steps_to_next_obs`.
"""

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, ValueEstimators
from torchrl.objectives.value import GAE

from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.ddpg import DDPG, DDPGSettings, OneHotRelaxation
from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.algorithms.ppo import PPO, PPOSettings
from hrl_escape.agents.algorithms.sarsa import Sarsa, SarsaSettings
from hrl_escape.agents.components.exploration import compute_policy
from hrl_escape.agents.components.policy_gradient import Rollout, compute_advantages
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.single_env import serve_one

GAMMA = 0.93
SIZE, INPUTS, ACTIONS = 64, 5, 4
SPACES = (gymnasium.spaces.Box(-np.inf, np.inf, (INPUTS,), np.float32), gymnasium.spaces.Discrete(ACTIONS))
COMMON = {"gamma": GAMMA, "hidden": (16,), "reward_scale": 1.0}


def make_batch(seed):
    """Random decisions: durations to 30, some terminal, masks with at least one legal action."""
    rng = np.random.default_rng(seed)
    duration = rng.integers(1, 31, SIZE)
    terminated = rng.random(SIZE) < 0.2
    mask, next_mask = rng.random((2, SIZE, ACTIONS)) < 0.6
    next_mask[np.arange(SIZE), rng.integers(ACTIONS, size=SIZE)] = True
    action = rng.integers(ACTIONS, size=SIZE)
    mask[np.arange(SIZE), action] = True
    experience = Experience(
        rng.standard_normal((SIZE, INPUTS)).astype(np.float32),
        mask,
        action,
        rng.standard_normal(SIZE).astype(np.float32),
        (GAMMA**duration * ~terminated).astype(np.float32),
        rng.standard_normal((SIZE, INPUTS)).astype(np.float32),
        next_mask,
    )
    return experience, duration, terminated


def make(agent_class, settings, seed=0):
    """An agent whose target networks differ from its online ones."""
    agent = agent_class(*SPACES, seed, settings)
    generator = torch.Generator().manual_seed(seed)
    for name in ("target", "target_actor", "target_critic"):
        for parameter in getattr(agent, name, torch.nn.Identity()).parameters():
            parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return agent


def forward(network, x):
    """The perceptron in float64 numpy, written out."""
    *hidden, last = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    tanh = any(isinstance(layer, torch.nn.Tanh) for layer in network)
    for layer in hidden:
        x = x @ layer.weight.detach().double().numpy().T + layer.bias.detach().double().numpy()
        x = np.tanh(x) if tanh else np.maximum(x, 0)
    return x @ last.weight.detach().double().numpy().T + last.bias.detach().double().numpy()


def huber(error):
    return np.where(np.abs(error) < 1, 0.5 * error**2, np.abs(error) - 0.5).mean()


def compute_loss(agent, batch, *more):
    """Loss and values of an agent with action values."""
    tensors = Experience(*map(torch.as_tensor, batch))
    with torch.no_grad():
        targets = agent.compute_targets(tensors, *more)
    return agent.values.compute_loss(tensors, targets)


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_dqn_loss_equals_the_formula_by_hand(seed, double):
    batch, duration, terminated = make_batch(seed)
    agent = make(DQN, DQNSettings(**COMMON, double=double), seed)
    targets = np.empty(SIZE)
    networks = agent.values.online, agent.values.target
    online, target = (forward(network, batch.next_observation) for network in networks)
    for i in range(SIZE):
        chooser = online if double else target
        legal = [o for o in range(ACTIONS) if batch.next_mask[i, o]]
        best = max(legal, key=chooser[i].__getitem__)
        targets[i] = batch.reward[i] + (0 if terminated[i] else GAMMA ** int(duration[i]) * target[i, best])
    values = forward(agent.values.online, batch.observation)[np.arange(SIZE), batch.action]
    loss, predicted = compute_loss(agent, batch)
    assert loss.item() == pytest.approx(huber(values - targets), abs=1e-6)
    assert predicted.numpy() == pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize("double", [False, True])
def test_dqn_loss_equals_torchrls(double):
    batch, duration, terminated = make_batch(7)
    agent = make(DQN, DQNSettings(**COMMON, double=double), 7)
    actor = QValueActor(
        TensorDictModule(agent.values.online, in_keys=["observation"], out_keys=["action_value"]),
        spec=None,
        action_space="categorical",
        action_mask_key="action_mask",
    )
    reference = DQNLoss(
        actor, loss_function="smooth_l1", double_dqn=double, delay_value=True, action_space="categorical"
    )
    reference.make_value_estimator(ValueEstimators.TD0, gamma=GAMMA)
    for name, parameter in agent.values.target.named_parameters():
        # The actor holds the network as its first module; its parameters keep their names below it.
        holder = reference.target_value_network_params["module", "0", "module"]
        holder.get(tuple(name.split("."))).data.copy_(parameter.data)
    data = TensorDict(
        {
            "observation": torch.from_numpy(batch.observation),
            "action_mask": torch.from_numpy(batch.mask),
            "action": torch.from_numpy(batch.action),
            "steps_to_next_obs": torch.from_numpy(duration)[:, None],
            "next": {
                "observation": torch.from_numpy(batch.next_observation),
                "action_mask": torch.from_numpy(batch.next_mask),
                "reward": torch.from_numpy(batch.reward)[:, None],
                "terminated": torch.from_numpy(terminated)[:, None],
                "done": torch.from_numpy(terminated)[:, None],
            },
        },
        [SIZE],
    )
    assert compute_loss(agent, batch)[0].item() == pytest.approx(reference(data)["loss"].item(), abs=1e-6)


def test_trap_9_an_illegal_action_of_value_a_million_leaves_every_target_alone():
    batch, _, _ = make_batch(3)
    illegal = 2
    batch.next_mask[:, illegal] = False
    batch.next_mask[:, 0] = True
    batch.action[:] = 1

    def compute_losses():
        agents = make(DQN, DQNSettings(**COMMON)), make(Sarsa, SarsaSettings(**COMMON))
        before = [compute_loss(agent, batch)[0].item() for agent in agents]
        for agent in agents:
            for network in (agent.values.online, agent.values.target):
                network[-1].bias.data[illegal] = 1e6
        return before, [compute_loss(agent, batch)[0].item() for agent in agents]

    before, after = compute_losses()
    assert after == before


def test_the_target_network_stands_still_between_its_updates():
    batch, _, _ = make_batch(0)
    agent = make(DQN, DQNSettings(**COMMON, target_rate=1.0, target_every=3))
    before = agent.values.target.weights.clone()
    moved = []
    for _ in range(6):
        agent.update(batch)
        moved.append((agent.values.target.weights != before).any().item())
        before = agent.values.target.weights.clone()
        assert (before == agent.values.online.weights).all().item() == moved[-1], "a rate of 1 copies"
    assert moved == [False, False, True] * 2


def test_the_greedy_policy_follows_the_average_and_exploration_the_online_network():
    batch, _, _ = make_batch(0)
    agent = make(DQN, DQNSettings(**COMMON, average_rate=0.25, epsilon_start=0.0, epsilon_end=0.0, learning_rate=0.1))
    history = []
    for _ in range(6):
        agent.update(batch)
        history.append(agent.values.online.weights.clone())
    mean = history[0]
    for number, weights in enumerate(history[1:], start=2):
        mean = mean + max(0.25, 1 / number) * (weights - mean)
    assert agent.values.average.weights.numpy() == pytest.approx(mean.numpy(), abs=1e-6)
    observations, legal = batch.observation, np.ones(ACTIONS, np.bool_)
    exploring = [serve_one(agent).act(each, legal) for each in observations]
    greedy = [agent.act_greedy(each, legal, np.random.default_rng(0)) for each in observations]
    assert exploring == forward(agent.values.online, observations).argmax(axis=1).tolist()
    assert greedy == forward(agent.values.average, observations).argmax(axis=1).tolist()
    assert greedy != exploring


@pytest.mark.parametrize("exploration", ["epsilon-greedy", "boltzmann"])
@pytest.mark.parametrize("seed", range(3))
def test_expected_sarsa_loss_equals_the_formula_by_hand(seed, exploration):
    batch, duration, terminated = make_batch(seed)
    settings = SarsaSettings(**COMMON, exploration=exploration, epsilon_start=0.4, epsilon_end=0.4, loss="squared")
    agent = make(Sarsa, settings, seed)
    policy = compute_policy(forward(agent.values.online, batch.next_observation), batch.next_mask, settings, 0)
    expectation = (policy * forward(agent.values.target, batch.next_observation)).sum(axis=1)
    targets = batch.reward + np.where(terminated, 0, GAMMA**duration) * expectation
    values = forward(agent.values.online, batch.observation)[np.arange(SIZE), batch.action]
    assert compute_loss(agent, batch)[0].item() == pytest.approx(0.5 * np.mean((values - targets) ** 2), abs=1e-6)


def test_sampled_sarsa_bootstraps_from_the_given_next_action():
    batch, duration, _ = make_batch(0)
    one = Experience(*(field[:1] for field in batch))
    one.bootstrap[:] = GAMMA ** duration[0]
    agent = make(Sarsa, SarsaSettings(**COMMON, expected=False, loss="squared"))
    for next_action in range(ACTIONS):
        next_values = forward(agent.values.target, one.next_observation)
        target = one.reward[0] + GAMMA ** duration[0] * next_values[0, next_action]
        value = forward(agent.values.online, one.observation)[0, one.action[0]]
        loss = compute_loss(agent, one, next_action)[0].item()
        assert loss == pytest.approx(0.5 * (value - target) ** 2, abs=1e-6)


@pytest.mark.parametrize("relaxation", ["one-hot", "linear"])
@pytest.mark.parametrize("seed", range(3))
def test_ddpg_losses_equal_the_formulas_by_hand(seed, relaxation):
    batch, duration, terminated = make_batch(seed)
    rng = np.random.default_rng(seed)
    relaxed = rng.standard_normal((SIZE, ACTIONS)).astype(np.float32)
    batch = batch._replace(action=relaxed)
    agent = make(DDPG, DDPGSettings(**COMMON, relaxation=relaxation, entropy_weight=0.1), seed)

    def act(outputs, mask):
        if relaxation == "linear":
            return outputs
        return np.eye(ACTIONS)[np.where(mask, outputs, -np.inf).argmax(axis=1)]

    next_action = act(forward(agent.target_actor, batch.next_observation), batch.next_mask)
    next_value = forward(agent.target_critic, np.hstack((batch.next_observation, next_action)))[:, 0]
    targets = batch.reward + np.where(terminated, 0, GAMMA**duration) * next_value
    value = forward(agent.critic, np.hstack((batch.observation, relaxed)))[:, 0]
    assert agent.compute_critic_loss(batch).item() == pytest.approx(huber(value - targets), abs=1e-6)

    outputs = forward(agent.actor, batch.observation)
    if relaxation == "linear":
        expected = -forward(agent.critic, np.hstack((batch.observation, outputs))).mean()
    else:
        weights = np.where(batch.mask, np.exp(outputs), 0)
        policy = weights / weights.sum(axis=1, keepdims=True)
        rows = [np.tile(one_hot, (SIZE, 1)) for one_hot in np.eye(ACTIONS)]
        values = np.hstack([forward(agent.critic, np.hstack((batch.observation, row))) for row in rows])
        expected = -(policy * values).sum(axis=1).mean()
        expected += 0.1 * np.where(batch.mask, policy * np.log(np.maximum(policy, 1e-300)), 0).sum(axis=1).mean()
    assert agent.compute_actor_loss(batch).item() == pytest.approx(expected, abs=1e-6)


def test_ddpgs_actor_loss_has_the_policy_gradient_and_leaves_the_critic_alone():
    batch, _, _ = make_batch(0)
    agent = make(DDPG, DDPGSettings(**COMMON, entropy_weight=0.0))
    agent.actor.gradient.zero_()
    agent.critic.gradient.zero_()
    agent.compute_actor_loss(batch).backward()
    weights = agent.actor.weights.clone()
    direction = torch.from_numpy(np.random.default_rng(0).standard_normal(len(weights)).astype(np.float32))
    ends = []
    for sign in (1, -1):
        agent.actor.weights.copy_(weights + sign * 1e-2 * direction / direction.norm())
        ends.append(agent.compute_actor_loss(batch).item())
    slope = (agent.actor.gradient @ direction / direction.norm()).item()
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-2, rel=0.02)
    assert not agent.critic.gradient.any()


def test_ddpgs_relaxed_action_is_the_best_legal_one_hot():
    outputs = torch.tensor([[3.0, 1.0, 0.5], [0.1, 0.0, 0.2]])
    mask = torch.tensor([[False, True, True], [True, True, True]])
    assert OneHotRelaxation(0.0).relax(outputs, mask).tolist() == [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize("average_actor", [True, False])
def test_ddpgs_greedy_policy_is_the_argmax_of_the_averaged_actor_or_of_the_actor(average_actor):
    agent = make(DDPG, DDPGSettings(**COMMON, average_actor=average_actor))
    rng, mask = np.random.default_rng(0), np.array([True] * (ACTIONS - 1) + [False])
    agent.actor.weights.copy_(torch.from_numpy(rng.standard_normal(len(agent.actor.weights)).astype(np.float32)))
    observations = rng.standard_normal((50, INPUTS)).astype(np.float32)
    network, other = (agent.target_actor, agent.actor) if average_actor else (agent.actor, agent.target_actor)
    expected, others = (forward(each, observations)[:, :-1].argmax(axis=1) for each in (network, other))
    assert [agent.act_greedy(observation, mask, rng) for observation in observations] == expected.tolist()
    assert (expected != others).any()


# --- PPO ------------------------------------------------------------------------------------


def make_rollout(seed):
    batch, duration, terminated = make_batch(seed)
    rng = np.random.default_rng(seed)
    truncated = ~terminated & (rng.random(SIZE) < 0.1)
    # Within an episode the state reached is the next decision's; at its end it is one of its own.
    over = terminated | truncated
    next_observation = batch.next_observation.copy()
    inside = np.flatnonzero(~over[:-1])
    next_observation[inside] = batch.observation[inside + 1]
    columns = (batch.observation, batch.mask, batch.action, np.zeros(SIZE, np.float32), batch.reward, batch.bootstrap,
               duration, over, next_observation, np.zeros((SIZE, 0), np.float32), np.zeros(SIZE, np.int64),
               np.arange(SIZE))
    return Rollout(*map(torch.from_numpy, columns)), torch.from_numpy(terminated)


@pytest.mark.parametrize("lambda_per", ["decision", "primitive"])
@pytest.mark.parametrize("seed", range(3))
def test_trap_16_advantages_equal_the_sum_of_discounted_errors_with_lambda_as_named(seed, lambda_per):
    rollout, terminated = make_rollout(seed)
    settings = PPOSettings(gamma=GAMMA, gae_lambda=0.8, lambda_per=lambda_per)
    values, next_values = torch.from_numpy(np.random.default_rng(seed).standard_normal((2, SIZE)))
    bootstrap = torch.where(terminated, 0.0, GAMMA ** rollout.duration.double())
    delta = (rollout.reward + bootstrap * next_values - values).numpy()
    expected = np.zeros(SIZE)
    for t in range(SIZE):
        weight = 1.0
        for later in range(t, SIZE):
            expected[t] += weight * delta[later]
            if rollout.over[later]:
                break
            k = int(rollout.duration[later])
            weight *= GAMMA**k * 0.8 ** (k if lambda_per == "primitive" else 1)
    assert compute_advantages(rollout, values, next_values, settings).numpy() == pytest.approx(expected, abs=1e-5)


def test_advantages_equal_torchrls():
    rollout, terminated = make_rollout(4)
    agent = PPO(*SPACES, 0, PPOSettings(**COMMON, gae_lambda=0.8))
    critic = TensorDictModule(agent.critic, in_keys=["observation"], out_keys=["state_value"])
    reference = GAE(gamma=GAMMA, lmbda=0.8, value_network=critic, vectorized=False)
    flag = {"terminated": terminated, "done": rollout.over}
    data = TensorDict(
        {
            "observation": rollout.observation,
            "steps_to_next_obs": rollout.duration[:, None],
            "next": {
                "observation": rollout.next_observation,
                "reward": rollout.reward[:, None],
                **{key: value[:, None] for key, value in flag.items()},
            },
        },
        [SIZE],
    )
    with torch.no_grad():
        values, next_values = (agent.critic(o).squeeze(1) for o in (rollout.observation, rollout.next_observation))
        expected = reference(data)["advantage"].squeeze(1).numpy()
    found = compute_advantages(rollout, values, next_values, agent.settings)
    assert found.numpy() == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_ppo_loss_equals_the_formula_by_hand(seed):
    rollout, _ = make_rollout(seed)
    rng = np.random.default_rng(seed)
    settings = PPOSettings(**COMMON, entropy_weight=0.05)
    agent = PPO(*SPACES, seed, settings)
    agent.policy[-1].weight.data *= 100  # away from the uniform start
    old, advantage, target = rng.standard_normal((3, SIZE)).astype(np.float32)
    old = -np.abs(old)
    rollout = Rollout(*(field.numpy() for field in rollout))
    logits = np.where(rollout.mask, forward(agent.policy, rollout.observation), -np.inf)
    policy = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    ratio = policy[np.arange(SIZE), rollout.action] / np.exp(old)
    normalised = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)
    gain = np.minimum(ratio * normalised, np.clip(ratio, 0.8, 1.2) * normalised).mean()
    error = 0.5 * ((forward(agent.critic, rollout.observation)[:, 0] - target) ** 2).mean()
    entropy = -np.where(rollout.mask, policy * np.log(np.maximum(policy, 1e-300)), 0).sum(axis=1).mean()
    columns = (rollout.observation, rollout.mask, rollout.action, old, advantage, target)
    loss = agent.compute_loss(*map(torch.from_numpy, columns))["loss"]
    assert loss.item() == pytest.approx(-gain + 0.5 * error - 0.05 * entropy, abs=2e-6)


def test_targets_begin_as_the_network_they_are_copied_from():
    agent = DQN(*SPACES, 0, DQNSettings(**COMMON, average_rate=0.01))
    for copy in (agent.values.target, agent.values.average):
        assert torch.equal(copy.weights, agent.values.online.weights) and copy is not agent.values.online


def test_logged_numbers_are_means_over_the_updates():
    """The entropy of a new policy is that of the uniform one."""
    agent = PPO(*SPACES, 0, PPOSettings(**COMMON, rollout=SIZE, batch_size=16, epochs=2, learning_rate=1e-6))
    rng, every, told = np.random.default_rng(0), np.ones(ACTIONS, np.bool_), {}
    for _ in range(SIZE):
        seen, following = rng.standard_normal((2, INPUTS)).astype(np.float32)
        step = following, -1.0, False, False, {}
        action = serve_one(agent).act(seen, every)
        told = serve_one(agent).observe(make_transition(seen, action, every, step, GAMMA))
    assert told["entropy"] == pytest.approx(np.log(ACTIONS), rel=0.01)
