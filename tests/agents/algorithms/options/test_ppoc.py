"""PPOC's terminations: their gradient against an exact one, their rate against the published one, and a room."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents import train
from hrl_escape.agents.algorithms.options.ppoc import OptionSamples
from hrl_escape.agents.making import make_agent
from tests.agents.algorithms.options.test_option_networks import make, make_rollout

STATES, OPTIONS, ACTIONS, GAMMA, COST = 4, 2, 3, 0.9, 0.2


def make_tabular_agent():
    """Networks without hidden layers over one-hot states, so that every table can be set."""
    space = spaces.Box(-np.inf, np.inf, (STATES,), np.float32)
    agent = make_agent("ppoc", space, spaces.Discrete(ACTIONS), 0, gamma=GAMMA, hidden=(), options=OPTIONS,
                       reward_scale=1.0, deliberation_cost=COST)
    generator = torch.Generator().manual_seed(0)
    for network in agent.heads.networks.values():
        network.weights.copy_(torch.randn(network.weights.shape, generator=generator))
    return agent


def read_tables(agent):
    """Policies (options, states, actions), pi_Omega and beta (states, options) in float64."""
    every = np.eye(STATES, dtype=np.float32)
    legal = np.ones(ACTIONS, np.bool_)
    policies = np.array([agent.compute_policies(state, legal) for state in every]).swapaxes(0, 1)
    choice = np.array([agent.heads.compute_option_policy(state) for state in every])
    beta = np.array([agent.compute_terminations(state) for state in every])
    return policies, choice, beta


def solve(policies, choice, beta, moves, rewards, price):
    """Exact Q(s, o), and the discounted number of arrivals in s' with o that ran, both (states, options).

    A move that ends the task is one that leads nowhere; an option begins in state 0, drawn from pi_Omega.
    """
    size = STATES * OPTIONS
    arrive = np.zeros((size, size))  # (s, o) -> (s', o that ran)
    go_on = np.zeros((size, size))  # (s', o that ran) -> (s', o that runs on)
    paid, gained = np.zeros(size), np.zeros(size)
    for s in range(STATES):
        for o in range(OPTIONS):
            here = s * OPTIONS + o
            gained[here] = policies[o, s] @ rewards[s]
            arrive[here, o::OPTIONS] = GAMMA * policies[o, s] @ moves[s]
            go_on[here, s * OPTIONS:(s + 1) * OPTIONS] = beta[s, o] * choice[s]
            go_on[here, here] += 1 - beta[s, o]
            paid[here] = beta[s, o] * price
    values = np.linalg.solve(np.eye(size) - arrive @ go_on, gained - arrive @ paid)
    begins = np.zeros(size)
    begins[:OPTIONS] = choice[0]
    visits = np.linalg.solve((np.eye(size) - arrive @ go_on).T, begins)
    return values.reshape(STATES, OPTIONS), (visits @ arrive).reshape(STATES, OPTIONS)


def test_the_gradient_of_terminations_is_that_of_the_exact_value_and_nothing_is_learned_where_the_task_ended():
    """Termination gradient theorem of Bacon, Harb and Precup (2017), with a price of ending."""
    agent, rng = make_tabular_agent(), np.random.default_rng(0)
    moves = rng.dirichlet(np.ones(STATES + 1), (STATES, ACTIONS))[..., :STATES]  # the rest ends the task
    rewards = rng.standard_normal((STATES, ACTIONS))

    def compute_value():
        policies, choice, beta = read_tables(agent)
        return choice[0] @ solve(policies, choice, beta, moves, rewards, COST)[0][0]

    policies, choice, beta = read_tables(agent)
    values, arrivals = solve(policies, choice, beta, moves, rewards, COST)
    (layer,) = [each for each in agent.heads.critic if isinstance(each, torch.nn.Linear)]
    layer.weight.data.copy_(torch.from_numpy(values.T))
    layer.bias.data.zero_()
    ending = agent.heads.networks["ending"]
    ending.gradient.zero_()
    every = torch.eye(STATES)
    for state in range(STATES):
        for option in range(OPTIONS):
            for goes_on in (True, False):
                loss = agent.heads.compute_termination_loss(
                    every[[state]], torch.tensor([goes_on]), torch.tensor([option]), COST)
                (loss * arrivals[state, option]).backward()
    found = -ending.gradient.double().numpy()
    before, exact = ending.weights.clone(), np.zeros(len(found))
    for number in range(len(found)):
        sides = []
        for step in (1e-2, -1e-2):
            ending.weights.copy_(before)
            ending.weights[number] += step
            sides.append(compute_value())
        exact[number] = (sides[0] - sides[1]) / 2e-2
    assert np.abs(exact).max() > 0.05
    assert found == pytest.approx(exact, abs=2e-4)


def test_the_rate_of_terminations_is_what_the_published_program_comes_to():
    """Its Adam holds the moments of both steps: that of 3e-4 moves terminations on by what that of 5e-7 left behind."""
    position = mean = square = 0.0
    for pair in range(2_000):
        before = position
        for step, (rate, gradient) in enumerate(((5e-7, 1.0), (3e-4, 0.0)), start=1):
            mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
            updates = 2 * pair + step
            position -= rate * (1 - 0.999**updates) ** 0.5 / (1 - 0.9**updates) * mean / (square**0.5 + 1e-5)
        moved = before - position
    assert make("ppoc").settings.termination_rate == pytest.approx(moved, rel=0.01) == pytest.approx(2e-4, rel=0.01)


def test_terminations_step_with_every_minibatch_of_the_option_s_own_decisions():
    agent, (rollout, choices) = make("ppoc", least_samples=2, epochs=3, batch_size=64), make_rollout(6)
    counts = np.bincount(choices.option.numpy(), minlength=3)
    agent._learn(rollout, choices)
    assert (counts > 1).all() and agent._ending_learner.updates == agent.heads.learner.updates == 3 * len(counts)
    with torch.no_grad():
        every = agent.compute_samples(rollout, choices)
    option = int(choices.option[rollout.bootstrap == 0][0])
    rows = choices.option == option
    reached, goes_on = rollout.next_observation[rows], (rollout.bootstrap > 0)[rows]
    values, betas = agent.heads.critic(reached), agent.heads.compute_betas(reached)[:, option]
    mean = (agent.heads.compute_fresh_choice(reached) * values).sum(dim=1)
    expected = (betas * (values[:, option] - mean) * goes_on).mean().item()
    found = agent.step_termination(option, OptionSamples(*(field[rows] for field in every)))
    assert found["termination_loss"].item() == pytest.approx(expected, abs=1e-5)
    assert goes_on.any() and not goes_on.all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_in_a_room_options_end_in_some_states_and_go_on_in_others(seed):
    """Where terminations are not learned, each has the probability that it began with."""
    spreads = []
    for settings in ({}, {"termination_rate": 0.0}):
        env = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-one-button")
        agent = train("ppoc", env, primitives=8_000, seed=seed, settings=settings).agent
        rng, betas = np.random.default_rng(0), []
        observation, _ = env.reset(seed=0)
        for _ in range(300):
            betas.append(agent.compute_terminations(observation))
            greedy = agent.act_greedy(observation, np.ones(env.action_space.n, np.bool_), rng)
            action = greedy if rng.random() < 0.5 else int(rng.integers(env.action_space.n))
            observation, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                observation, _ = env.reset()
        spreads.append(np.ptp(betas, axis=0))
        env.close()
    assert spreads[0].min() > 0.05 and spreads[1].max() < 0.01
