"""DAC, PPOC and A2OC: PPO to the bit with one option, losses and gradients by hand, what each decision teaches."""

from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.option_networks import NONE, OptionChoices, mix_values, mix_with_former
from hrl_escape.agents.components.policy_gradient import Rollout
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.single_env import serve_one
from hrl_escape.errors import UnknownNameError
from tests.agents.running import interact
from tests.agents.small_envs import ButtonGrid

GAMMA, OPTIONS, ACTIONS, SIZE = 0.9, 3, 4, 24
BOX = spaces.Box(-np.inf, np.inf, (5,), np.float32)


def make(name, **settings):
    """An agent whose heads are far from their even start."""
    chosen = {"gamma": GAMMA, "hidden": (8,), "options": OPTIONS, "reward_scale": 1.0} | settings
    agent = make_agent(name, BOX, spaces.Discrete(ACTIONS), 0, **chosen)
    for key in agent.heads.networks:
        if key != "critic":
            agent.heads.networks[key][-1].weight.data *= 100
    return agent


def make_rollout(seed=0):
    """Random decisions with masks, durations, terminations and truncations; options that switch now and then."""
    rng = np.random.default_rng(seed)
    terminated = rng.random(SIZE) < 0.15
    over = terminated | (rng.random(SIZE) < 0.15)
    duration = rng.integers(1, 6, SIZE)
    mask = rng.random((SIZE, ACTIONS)) < 0.6
    action = rng.integers(ACTIONS, size=SIZE)
    mask[np.arange(SIZE), action] = True
    observation = rng.standard_normal((SIZE, 5)).astype(np.float32)
    reached = rng.standard_normal((SIZE, 5)).astype(np.float32)
    inside = np.flatnonzero(~over[:-1])
    reached[inside] = observation[inside + 1]
    bootstrap = (GAMMA**duration * ~terminated).astype(np.float32)
    columns = (observation, mask, action, np.zeros(SIZE, np.float32), rng.standard_normal(SIZE).astype(np.float32),
               bootstrap, duration, over, reached, np.zeros((SIZE, 0), np.float32), np.zeros(SIZE, np.int64),
               np.arange(SIZE))
    option = rng.integers(OPTIONS, size=SIZE)
    former = np.r_[NONE, np.where(over[:-1], NONE, option[:-1])]
    is_chosen = (option != former) | (rng.random(SIZE) < 0.3)
    return Rollout(*map(torch.from_numpy, columns)), OptionChoices(*map(torch.from_numpy, (option, former, is_chosen)))


def softmax(logits):
    weights = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return weights / weights.sum(axis=-1, keepdims=True)


def read(agent, observation):
    """Policies (n, options, actions), values, pi_Omega and beta (n, options) in float64, action masks left out."""
    with torch.no_grad():
        numbers = {key: network(observation).double().numpy() for key, network in agent.heads.networks.items()}
    if "chooser" in numbers:
        choice = softmax(numbers["chooser"])
    else:
        epsilon, best = agent.settings.epsilon, numbers["critic"].argmax(axis=1)
        choice = epsilon / OPTIONS + (1 - epsilon) * np.eye(OPTIONS)[best]
    return (numbers["policy"].reshape(-1, OPTIONS, ACTIONS), numbers["critic"], choice,
            1 / (1 + np.exp(-numbers["ending"])))


def mix_by_hand(chooser, beta, former):
    return np.array([p if o == NONE else b[o] * p + (1 - b[o]) * np.eye(OPTIONS)[o]
                     for p, b, o in zip(chooser, beta, former, strict=True)])


# --- what they share ----------------------------------------------------------------------


@pytest.mark.parametrize(("name", "settings"), [("dac", {}), ("ppoc", {"least_samples": 32})])
def test_with_one_option_it_is_ppo(name, settings):
    """Masks, durations, truncations; actions, critic and policy."""
    small = {"hidden": (8,), "rollout": 32, "batch_size": 16, "epochs": 2}
    env = ButtonGrid(trace=True, horizon=40)
    one, other = (make_agent(agent, env.observation_space, env.action_space, 3, **small, **more)
                  for agent, more in (("ppo", {}), (name, {"options": 1} | settings)))
    ways = [[step.action for step in interact(agent, ButtonGrid(trace=True, horizon=40), 150, 3)]
            for agent in (one, other)]
    assert ways[0] == ways[1]
    for key in ("policy", "critic"):
        torch.testing.assert_close(getattr(one, key).weights, other.heads.networks[key].weights, rtol=0.0, atol=1e-6)


def test_the_option_before_is_kept_unless_it_ends_and_a_first_one_is_drawn_from_the_policy_over_options():
    rng = np.random.default_rng(0)
    chooser, beta = softmax(rng.standard_normal((4, OPTIONS))), rng.random((4, OPTIONS))
    former = np.array([NONE, 0, 2, NONE])
    found = mix_with_former(*map(torch.from_numpy, (beta, chooser, former))).numpy()
    assert found == pytest.approx(mix_by_hand(chooser, beta, former))
    values = rng.standard_normal((4, OPTIONS))
    mean = mix_values(*map(torch.from_numpy, (found, values, former))).numpy()
    assert mean == pytest.approx((found * values).sum(axis=1))


@pytest.mark.parametrize("name", ["dac", "ppoc", "a2oc"])
def test_the_state_reached_is_worth_the_option_that_ran_next_and_the_mean_where_none_did(name):
    agent, (rollout, choices) = make(name), make_rollout()
    _, values, chooser, beta = read(agent, rollout.next_observation)
    with torch.no_grad():
        found, mean = (each.numpy() for each in agent.heads.compute_next_values(rollout, choices))
    option = choices.option.numpy()
    expected = (mix_by_hand(chooser, beta, option) * values).sum(axis=1)
    assert mean == pytest.approx(expected, abs=1e-5)
    for row in range(SIZE):
        goes_on = row + 1 < SIZE and not rollout.over[row]
        assert found[row] == pytest.approx(values[row, option[row + 1]] if goes_on else expected[row], abs=1e-5)


def test_rows_tell_which_option_ran_before_and_whether_one_was_chosen():
    agent = make("dac", rollout=1_000)
    served, rng = serve_one(agent), np.random.default_rng(0)
    for number in range(200):
        here, there = rng.standard_normal((2, 5)).astype(np.float32)
        action, over = served.act(here, np.ones(ACTIONS, np.bool_)), number % 10 == 9
        served.observe(SMDPTransition(here, action, np.ones(ACTIONS, np.bool_), 0.0, 0.0, 1, GAMMA, there,
                                      np.ones(ACTIONS, np.bool_), False, over))
    option, former, is_chosen = (np.array(column) for column in zip(*agent._choices, strict=True))
    first = np.arange(200) % 10 == 0
    assert (former[first] == NONE).all() and is_chosen[first].all()
    assert (former[~first] == option[:-1][~first[1:]]).all()
    assert (is_chosen | (option == former)).all()
    assert 0 < (is_chosen & (option == former)).sum(), "an option may be chosen again"
    assert not (is_chosen | first).all()
    assert agent.log.compute_duration() == pytest.approx(200 / is_chosen.sum())


def test_in_evaluation_an_option_runs_until_another_is_likelier_and_exported_options_draw():
    agent = make("dac")
    rng = np.random.default_rng(1)
    seen, all_legal = rng.standard_normal((40, 5)).astype(np.float32), np.ones(ACTIONS, np.bool_)
    policies, _, chooser, beta = read(agent, torch.from_numpy(seen))
    running = None
    for row in range(40):
        action = agent.act_greedy(seen[row], all_legal, rng)
        choice = chooser[row] if running is None else mix_by_hand(chooser[[row]], beta[[row]], [running])[0]
        running = int(choice.argmax())
        assert action == policies[row, running].argmax()
        assert [call.task for call in agent.list_calls()] == [f"option-{running}"]
    assert {agent.act_greedy(state, all_legal, np.random.default_rng(0)) for state in seen} > {action}
    mask = np.array([True, False, True, True])
    run = agent.get_options()[1].begin()
    drawn = [run.act(seen[0], mask, rng) for _ in range(2_000)]
    expected = softmax(np.where(mask, policies[0, 1], -np.inf))
    assert np.bincount(drawn, minlength=ACTIONS) / 2_000 == pytest.approx(expected, abs=0.05)
    assert run.compute_termination(seen[0], mask) == pytest.approx(beta[0, 1], abs=1e-6)


def test_a_minibatch_of_one_decision_is_left_out():
    assert [len(rows) for rows in make("dac", batch_size=8, epochs=2)._draw_batches(17, 17)] == [8, 8, 8, 8]


@pytest.mark.parametrize("name", ["dac", "ppoc", "a2oc"])
def test_memory_and_objects_are_refused_as_the_page_says(name):
    page = (Path(__file__).parents[4] / "docs" / "agents" / f"{name}.md").read_text()
    assert "no `memory` and no `network=objects`" in page
    for setting in ("memory", "network"):
        with pytest.raises(UnknownNameError, match=f"'{setting}'"):
            make(name, **{setting: "objects"})


# --- DAC ----------------------------------------------------------------------------------


def list_updates(agent, rollout, choices, monkeypatch):
    """Old probabilities, advantages and targets that each of the two processes is updated with."""
    found = {}
    for name in ("compute_low_loss", "compute_high_loss"):
        method = getattr(agent, name)

        def spy(rollout, choices, rows, old, advantage, target, name=name, method=method):
            for key, numbers in zip(("old", "advantage", "target"), (old, advantage, target), strict=True):
                found.setdefault((name, key), np.zeros(SIZE))[rows.numpy()] = numbers.numpy()
            return method(rollout, choices, rows, old, advantage, target)

        monkeypatch.setattr(agent, name, spy)
    agent._learn(rollout, choices)
    return found


@pytest.mark.parametrize("first", [0, 2])
def test_both_processes_have_advantages_of_their_own_and_the_probabilities_of_the_networks_that_chose(
        first, monkeypatch):
    """Whichever of the two is updated first."""
    agent, (rollout, choices) = make("dac", batch_size=8, epochs=2, learning_rate=0.05), make_rollout(1)
    agent._batch_rng = np.random.default_rng(first)
    policies, values, chooser, beta = read(agent, rollout.observation)
    _, next_values, next_chooser, next_beta = read(agent, rollout.next_observation)
    option, former = choices.option.numpy(), choices.former.numpy()
    every = np.arange(SIZE)
    choice = mix_by_hand(chooser, beta, former)
    v = {"low": values[every, option], "high": (choice * values).sum(axis=1)}
    mean = (mix_by_hand(next_chooser, next_beta, option) * next_values).sum(axis=1)
    follows = np.r_[~rollout.over.numpy()[:-1], False]
    after = {"low": np.where(follows, next_values[every, np.roll(option, -1)], mean), "high": mean}
    legal = np.where(rollout.mask, policies[every, option], -np.inf)
    old = {"low": softmax(legal)[every, rollout.action], "high": choice[every, option]}
    found = list_updates(agent, rollout, choices, monkeypatch)
    for level in ("low", "high"):
        delta = rollout.reward.numpy() + rollout.bootstrap.numpy() * after[level] - v[level]
        advantage = np.zeros(SIZE + 1)
        for row in reversed(range(SIZE)):
            carry = 0 if rollout.over[row] else rollout.bootstrap[row].item() * agent.settings.gae_lambda
            advantage[row] = delta[row] + carry * advantage[row + 1]
        name = f"compute_{level}_loss"
        assert found[name, "advantage"] == pytest.approx(advantage[:-1], abs=1e-4), level
        assert found[name, "target"] == pytest.approx(advantage[:-1] + v[level], abs=1e-4), level
        assert np.exp(found[name, "old"]) == pytest.approx(old[level], abs=1e-5), level


def test_dacs_losses_equal_the_formulas_by_hand():
    agent, (rollout, choices) = make("dac", entropy_weight=0.05, option_entropy_weight=0.03, deliberation_cost=0.2), (
        make_rollout(2))
    rng = np.random.default_rng(0)
    old, advantage, target = rng.standard_normal((3, SIZE)).astype(np.float32)
    old, rows, every = -np.abs(old), torch.arange(SIZE), np.arange(SIZE)
    policies, values, chooser, beta = read(agent, rollout.observation)
    option, former = choices.option.numpy(), choices.former.numpy()
    normalised = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)

    def clipped(probability):
        ratio = probability / np.exp(old)
        return -np.minimum(ratio * normalised, np.clip(ratio, 0.8, 1.2) * normalised).mean()

    def surprise(policy):
        return -(policy * np.log(np.maximum(policy, 1e-300))).sum(axis=1).mean()

    policy = softmax(np.where(rollout.mask, policies[every, option], -np.inf))
    low = clipped(policy[every, rollout.action]) + 0.25 * ((values[every, option] - target) ** 2).mean()
    choice = mix_by_hand(chooser, beta, former)
    high = clipped(choice[every, option]) + 0.25 * (((choice * values).sum(axis=1) - target) ** 2).mean()
    ended = np.where(former == NONE, 0.0, beta[every, np.maximum(former, 0)]).mean()
    numbers = rollout, choices, rows, *map(torch.from_numpy, (old, advantage, target))
    assert agent.compute_low_loss(*numbers)["loss"].item() == pytest.approx(low - 0.05 * surprise(policy), abs=1e-4)
    found = agent.compute_high_loss(*numbers)["high_loss"].item()
    assert found == pytest.approx(high - 0.03 * surprise(choice) + 0.2 * ended, abs=1e-4)


def test_terminations_learn_through_the_choice_of_options_and_the_value_s_error_moves_the_critic_alone():
    agent, (rollout, choices) = make("dac", option_entropy_weight=0.0), make_rollout(3)
    rows, zeros = torch.arange(SIZE), torch.zeros(SIZE)
    with torch.no_grad():
        choice = agent.heads.compute_option_choice(rollout.observation, choices.former)
        old = choice[rows, choices.option].log()
    numbers = rollout, choices, rows, old

    def find_gradients(part, advantage, target):
        for network in agent.heads.networks.values():
            network.gradient.zero_()
        agent.compute_high_loss(*numbers, advantage, target)[part].backward()
        return {name: network.gradient.clone() for name, network in agent.heads.networks.items()}

    by_value = find_gradients("high_value_loss", zeros, zeros + 3)
    assert by_value["critic"].any() and not by_value["chooser"].any() and not by_value["ending"].any()
    advantage = torch.from_numpy(np.random.default_rng(0).standard_normal(SIZE).astype(np.float32))
    gradient = find_gradients("high_policy_loss", advantage, zeros)["ending"]
    weights, direction, ends = agent.heads.networks["ending"].weights.clone(), gradient / gradient.norm(), []
    for sign in (1, -1):
        agent.heads.networks["ending"].weights.copy_(weights + sign * 1e-3 * direction)
        ends.append(agent.compute_high_loss(*numbers, advantage, zeros)["high_policy_loss"].item())
    assert gradient.norm() > 1e-3
    assert gradient.norm().item() == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=0.05)


# --- PPOC ---------------------------------------------------------------------------------


def test_ppoc_pays_for_ending_upon_arrival_and_learns_choices_where_they_were_made():
    cost = 0.3
    plain, dear = make("ppoc", gae_lambda=0.0), make("ppoc", gae_lambda=0.0, deliberation_cost=cost)
    rollout, choices = make_rollout(4)
    with torch.no_grad():
        free, paid = (agent.compute_samples(rollout, choices) for agent in (plain, dear))
    _, values, chooser, _ = read(plain, rollout.observation)
    *_, beta = read(plain, rollout.next_observation)
    option, every = choices.option.numpy(), np.arange(SIZE)
    follows = np.r_[~rollout.over.numpy()[:-1], False]
    ends = np.where(follows, np.roll(choices.is_chosen.numpy(), -1), beta[every, option])
    assert (free.target - paid.target).numpy() == pytest.approx(cost * rollout.bootstrap.numpy() * ends, abs=1e-5)
    gain = free.target.numpy() - (chooser * values).sum(axis=1)
    assert free.choice_advantage.numpy() == pytest.approx(np.where(choices.is_chosen, gain, 0.0), abs=1e-5)


def test_ppocs_terminations_fall_where_the_option_that_ran_is_better_than_the_mean_at_the_state_reached():
    agent, (rollout, choices) = make("ppoc", deliberation_cost=0.2), make_rollout(5)
    _, values, chooser, beta = read(agent, rollout.next_observation)
    option, every = choices.option.numpy(), np.arange(SIZE)
    worse = values[every, option] - (chooser * values).sum(axis=1) + 0.2
    expected = (beta[every, option] * worse * (rollout.bootstrap.numpy() > 0)).mean()
    loss = agent.heads.compute_termination_loss(rollout.next_observation, rollout.bootstrap > 0, choices.option, 0.2)
    assert loss.item() == pytest.approx(expected, abs=1e-5)
    loss.backward()
    moved = [name for name, network in agent.heads.networks.items() if network.gradient.any()]
    assert moved == ["ending"]


def test_ppocs_terminations_move_at_their_own_rate():
    """Adam's first step is its rate, whatever the gradient; one option has samples enough for it."""
    rollout, choices = make_rollout(6)
    most = int(choices.option.bincount().max())
    assert (choices.option.bincount() == most).sum() == 1
    for rate in (0.0, 1e-4, 1e-2):
        agent = make("ppoc", termination_rate=rate, learning_rate=0.1, least_samples=most, epochs=1)
        before = agent.heads.networks["ending"].weights.clone()
        agent._learn(rollout, choices)
        assert (agent.heads.networks["ending"].weights - before).abs().max().item() == pytest.approx(rate, rel=0.01)


def test_an_option_waits_for_its_samples_and_then_learns_from_its_own():
    agent, (rollout, choices) = make("ppoc", least_samples=SIZE, epochs=1, batch_size=64), make_rollout(6)
    counts = np.bincount(choices.option.numpy(), minlength=OPTIONS)
    before = agent.heads.critic.weights.clone()
    agent._learn(rollout, choices)
    assert torch.equal(agent.heads.critic.weights, before)
    assert {option: len(own.action) for option, own in agent._waiting.items()} == dict(enumerate(counts))
    rounds = 1
    while torch.equal(agent.heads.critic.weights, before):
        metrics = agent._learn(rollout, choices)
        rounds += 1
    assert "loss" in metrics
    assert all((option in agent._waiting) == (rounds * counts[option] < SIZE) for option in range(OPTIONS))


# --- A2OC ---------------------------------------------------------------------------------


def test_a2ocs_loss_equals_the_formula_by_hand():
    """Returns that end in the value upon arrival, the price of ending, entropies, terminations at the state reached."""
    cost, margin = 0.3, 0.2
    agent, (rollout, choices) = make("a2oc", epsilon=0.3, deliberation_cost=cost, termination_margin=margin,
                                     entropy_weight=0.05), make_rollout(7)
    policies, values, _, _ = read(agent, rollout.observation)
    _, next_values, choice, beta = read(agent, rollout.next_observation)
    option, every, reward = choices.option.numpy(), np.arange(SIZE), rollout.reward.numpy()
    mean = (choice * next_values).sum(axis=1)
    ends = beta[every, option]
    arrival = (1 - ends) * next_values[every, option] + ends * (mean - cost)
    returns = np.zeros(SIZE + 1)
    for row in reversed(range(SIZE)):
        is_last = row + 1 == SIZE or rollout.over[row]
        after = arrival[row] if is_last else returns[row + 1] - cost * float(choices.is_chosen[row + 1])
        returns[row] = reward[row] + rollout.bootstrap[row].item() * after
    advantage = returns[:-1] - values[every, option]
    policy = softmax(np.where(rollout.mask, policies[every, option], -np.inf))
    entropy = -(policy * np.log(np.maximum(policy, 1e-300))).sum(axis=1).mean()
    worse = next_values[every, option] - mean + cost + margin
    expected = (-(np.log(policy[every, rollout.action]) * advantage).mean() + 0.25 * (advantage**2).mean()
                - 0.05 * entropy + (ends * worse * (rollout.bootstrap.numpy() > 0)).mean())
    before = agent.heads.policy.weights.clone()
    metrics = agent._learn(rollout, choices)
    assert metrics["loss"] == pytest.approx(expected, abs=1e-4)
    assert not torch.equal(agent.heads.policy.weights, before)


def test_a2oc_has_no_policy_over_options_but_the_values():
    agent = make("a2oc", epsilon=0.3)
    state = np.random.default_rng(0).standard_normal(5).astype(np.float32)
    expected = np.full(OPTIONS, 0.1)
    expected[agent.heads.compute_option_values(state).argmax()] += 0.7
    assert agent.heads.compute_option_policy(state) == pytest.approx(expected)
    assert set(agent.heads.networks) == {"policy", "critic", "ending"}
