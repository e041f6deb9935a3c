"""DAC and PPOC over many streams: both processes by hand over ragged decisions, options of each stream, resets."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.agents import train
from hrl_escape.agents.components.option_networks import NONE, OptionChoices
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.making import make_agent
from tests.agents.algorithms.options.test_option_networks import (
    ACTIONS,
    GAMMA,
    OPTIONS,
    make,
    mix_by_hand,
    read,
    softmax,
)
from tests.agents.training.test_many_envs import SMALL, Counting, make_life, make_rooms, sum_returns

CPU = torch.device("cpu")
PRIMITIVES = 60


class Lives:
    """Streams whose decisions last as long as was drawn before, with observations and masks at random.

    Attributes:
        rows: of each stream, its decisions in order: observation, mask, action, the state reached, duration,
            discounted reward, and how it ended.
    """

    def __init__(self, agent, count, seed):
        self.agent, self._rng = agent, np.random.default_rng(seed)
        self.lives = [make_life(self._rng, PRIMITIVES) for _ in range(count)]
        self._ends = [np.cumsum([len(rewards) for rewards, _ in life]) for life in self.lives]
        self.rows = [[] for _ in range(count)]
        self._now = [self._see() for _ in range(count)]
        agent.begin_episodes(count, CPU)

    @property
    def decisions(self):
        return sum(map(len, self.lives))

    def _see(self):
        mask = self._rng.random(ACTIONS) < 0.6
        mask[self._rng.integers(ACTIONS)] = True
        return self._rng.standard_normal(5).astype(np.float32), mask

    def run(self):
        """Live all lives; what decides and what is learned from go through the agent's own doors."""
        asking = list(range(len(self.lives)))
        for primitive in range(1, PRIMITIVES + 1):
            if asking:
                self._ask(asking)
            asking = [i for i in range(len(self.lives)) if primitive in self._ends[i]]
            if asking:
                self._report(asking)

    def _ask(self, asking):
        seen, masks = (torch.from_numpy(np.stack(part)) for part in zip(*(self._now[i] for i in asking), strict=True))
        actions = self.agent.act(Moments(torch.tensor(asking), seen, masks))
        for i, action in zip(asking, actions.tolist(), strict=True):
            self.rows[i].append([*self._now[i], action])

    def _report(self, ended):
        fields = []
        for i in ended:
            rewards, end = self.lives[i][len(self.rows[i]) - 1]
            reached, mask = self._see()
            discounted = float(sum(GAMMA**n * reward for n, reward in enumerate(rewards)))
            observation, legal, action = self.rows[i][-1]
            self.rows[i][-1] += [reached, len(rewards), discounted, end]
            self._now[i] = (reached, mask) if end == "on" else self._see()
            fields.append((i, observation, legal, action, np.float32(discounted), np.float32(rewards.sum()),
                           len(rewards), np.float32(GAMMA ** len(rewards)), reached, mask, end == "terminated",
                           end == "truncated"))
        self.agent.observe(Decisions(*(torch.from_numpy(np.array(field)) for field in zip(*fields, strict=True))))


def find_last(rollout):
    """True at the latest decision of each environment."""
    return torch.stack([place == rollout.place[rollout.stream == env].max()
                        for env, place in zip(rollout.stream, rollout.place, strict=True)])


def spy(agent, monkeypatch):
    """Rollouts and options that are learned from, and per process the numbers of each row."""
    found, learn = {}, agent._learn

    def keep(rollout, choices):
        found["rollout"], found["choices"] = rollout, choices
        return learn(rollout, choices)

    monkeypatch.setattr(agent, "_learn", keep)
    for level, method in (("low", agent.compute_low_loss), ("high", agent.compute_high_loss)):
        def look(rollout, choices, rows, *numbers, level=level, method=method):
            for name, values in zip(("old", "advantage", "target"), numbers, strict=True):
                found.setdefault((level, name), np.zeros(len(choices.option)))[rows.numpy()] = values.numpy()
            return method(rollout, choices, rows, *numbers)

        monkeypatch.setattr(agent, f"compute_{level}_loss", look)
    return found


def live(count, monkeypatch, **settings):
    """An agent that lived so many streams and learned from all of it at once, and what it was taught."""
    agent = make("dac", rollout=10**6, epochs=1, batch_size=16, learning_rate=1e-4, **settings)
    lives = Lives(agent, count, count)
    agent.settings = replace(agent.settings, rollout=lives.decisions, rollout_per_env=1)
    taught = spy(agent, monkeypatch)
    before = {name: network.weights.clone() for name, network in agent.heads.networks.items()}
    lives.run()
    for name, network in agent.heads.networks.items():
        network.weights.copy_(before[name])
    return agent, lives, taught


@pytest.mark.nightly_for("64", "8")
@pytest.mark.parametrize("count", [1, 8, 64])
def test_with_equal_values_both_processes_are_taught_the_returns_summed_by_hand(count, monkeypatch):
    """Every state is worth 0.7 to every option, so that lambda = 1 leaves the return primitive by primitive."""
    agent = make("dac", rollout=10**6, gae_lambda=1.0)
    agent.heads.critic[-1].weight.data.zero_()
    agent.heads.critic[-1].bias.data.fill_(0.7)
    lives = Lives(agent, count, count)
    agent.settings = replace(agent.settings, rollout=lives.decisions, rollout_per_env=1)
    taught = spy(agent, monkeypatch)
    lives.run()
    rollout = taught["rollout"]
    for i, life in enumerate(lives.lives):
        own = (rollout.stream == i).numpy()
        assert rollout.place[own].tolist() == list(range(len(life)))
        for level in ("low", "high"):
            assert taught[level, "target"][own] == pytest.approx(sum_returns(life, 0.7), abs=2e-3), level


@pytest.mark.nightly_for("64")
@pytest.mark.parametrize("count", [1, 8, 64])
def test_both_processes_are_taught_stream_by_stream_what_the_formulas_say(count, monkeypatch):
    agent, lives, taught = live(count, monkeypatch)
    rollout, choices = taught["rollout"], taught["choices"]
    place = {(int(i), int(at)): row for row, (i, at) in enumerate(zip(rollout.stream, rollout.place, strict=True))}
    assert len(place) == lives.decisions
    for i, rows in enumerate(lives.rows):
        order = [place[i, at] for at in range(len(rows))]
        seen, mask, action, reached, duration, reward, end = map(np.array, zip(*rows, strict=True))
        assert np.array_equal(rollout.observation[order].numpy(), seen)
        assert np.array_equal(rollout.mask[order].numpy(), mask) and rollout.action[order].tolist() == action.tolist()
        option, former, is_chosen = (field[order].numpy() for field in choices[:3])
        over = end != "on"
        assert former.tolist() == [NONE if at == 0 or over[at - 1] else option[at - 1] for at in range(len(rows))]
        assert (is_chosen | (option == former)).all() and is_chosen[former == NONE].all()
        policies, values, chooser, beta = read(agent, torch.from_numpy(seen))
        _, next_values, next_chooser, next_beta = read(agent, torch.from_numpy(reached))
        every = np.arange(len(rows))
        choice = mix_by_hand(chooser, beta, former)
        mean = (mix_by_hand(next_chooser, next_beta, option) * next_values).sum(axis=1)
        follows = np.r_[~over[:-1], False]
        worth = {"low": (values[every, option], np.where(follows, next_values[every, np.roll(option, -1)], mean)),
                 "high": ((choice * values).sum(axis=1), mean)}
        chance = {"low": softmax(np.where(mask, policies[every, option], -np.inf))[every, action],
                  "high": choice[every, option]}
        bootstrap = GAMMA**duration * (end != "terminated")
        for level, (here, after) in worth.items():
            delta, advantage = reward + bootstrap * after - here, np.zeros(len(rows) + 1)
            for at in reversed(range(len(rows))):
                carry = 0 if over[at] else bootstrap[at] * agent.settings.gae_lambda
                advantage[at] = delta[at] + carry * advantage[at + 1]
            assert taught[level, "advantage"][order] == pytest.approx(advantage[:-1], abs=2e-3), level
            assert taught[level, "target"][order] == pytest.approx(advantage[:-1] + here, abs=2e-3), level
            assert np.exp(taught[level, "old"][order]) == pytest.approx(chance[level], abs=1e-4), level


def test_runs_of_options_are_counted_in_every_stream():
    agent = make("dac", rollout=10**6)
    lives = Lives(agent, 8, 0)
    lives.run()
    rollout, choices = agent._many[0].gather()
    agent.state_dict()  # what is over is reported
    last = find_last(rollout)
    begun, unfinished = int(choices.is_chosen.sum()), int((last & ~rollout.over).sum())
    assert len(agent.log._runs) == begun - unfinished and unfinished > 0
    lasted, running = np.array(agent.log._runs), agent._many[1].state_dict()
    for option in range(OPTIONS):
        made = lasted[lasted[:, 0] == option, 1].sum() + running["decisions"][running["option"] == option].sum()
        assert made == int((choices.option == option).sum())


def test_streams_draw_ends_and_options_with_the_chances_that_are_kept_with_them():
    agent, count = make("dac", rollout=10**6), 20_000
    agent.begin_episodes(count, CPU)
    state = torch.tensor([[0.5, -0.5, 0.3, 1.0, -1.0]])
    seen, mask, streams = state.expand(count, 5), torch.ones(count, ACTIONS, dtype=torch.bool), torch.arange(count)
    _, _, chooser, beta = read(agent, state)

    def decide():
        action = agent.act(Moments(streams, seen, mask))
        one, no = torch.ones(count), torch.zeros(count, dtype=torch.bool)
        agent.observe(Decisions(streams, seen, mask, action, one, one, one.long(), GAMMA * one, seen, mask, no, no))
        return OptionChoices(*(field[-count:] for field in agent._many[0].gather()[1]))

    first, then = decide(), decide()
    assert np.bincount(first.option, minlength=OPTIONS) / count == pytest.approx(chooser[0], abs=0.015)
    assert first.log_probability.exp().numpy() == pytest.approx(chooser[0, first.option.numpy()], rel=1e-4)
    for former in range(OPTIONS):
        rows = (then.former == former).numpy()
        assert torch.equal(then.former, first.option)
        expected = mix_by_hand(chooser, beta, [former])[0]
        found = np.bincount(then.option[rows], minlength=OPTIONS) / rows.sum()
        assert found == pytest.approx(expected, abs=0.03)
        assert then.is_chosen[rows].float().mean().item() == pytest.approx(beta[0, former], abs=0.03)
        assert then.log_probability[rows].exp().numpy() == pytest.approx(expected[then.option[rows]], rel=1e-4)


@pytest.mark.parametrize("name", ["dac", "ppoc"])
def test_a_decision_that_outlasts_its_rollout_keeps_the_chances_that_it_was_made_with(name, monkeypatch):
    agent = make(name, rollout=4, rollout_per_env=1, batch_size=4, epochs=2, learning_rate=0.05, **(
        {"least_samples": 2} if name == "ppoc" else {}))
    agent.begin_episodes(3, CPU)
    rng = np.random.default_rng(0)
    mask, no = torch.ones(3, ACTIONS, dtype=torch.bool), torch.zeros(1, dtype=torch.bool)
    seen = torch.from_numpy(rng.standard_normal((3, 5)).astype(np.float32))
    policies, _, chooser, _ = read(agent, seen)
    action = agent.act(Moments(torch.arange(3), seen, mask))
    before = agent.heads.policy.weights.clone()
    taught, learn = [], agent._learn
    monkeypatch.setattr(agent, "_learn", lambda rollout, choices: (
        taught.append((rollout, choices, agent.heads.compute_old_log_probability(rollout, choices))),
        learn(rollout, choices)
    )[1])

    def end(stream, observation, chosen):
        one = torch.ones(1)
        agent.observe(Decisions(torch.tensor([stream]), observation, mask[:1], chosen, one, one, torch.tensor([3]),
                                GAMMA**3 * one, observation + 1, mask[:1], no, no))

    end(0, seen[:1], action[:1])
    for _ in range(6):
        chosen = agent.act(Moments(torch.tensor([0]), seen[:1] + 1, mask[:1]))
        end(0, seen[:1] + 1, chosen)
    assert len(taught) == 1 and not torch.equal(agent.heads.policy.weights, before), "the networks have moved on"
    end(2, seen[2:], action[2:])
    rollout, choices, old = taught[1]
    row = int((rollout.stream == 2).nonzero())
    option = int(choices.option[row])
    assert choices.log_probability[row].exp().item() == pytest.approx(chooser[2, option], rel=1e-4)
    assert old[row].exp().item() == pytest.approx(softmax(policies[2, option])[int(action[2])], rel=1e-4)


def test_the_choice_of_an_option_is_taught_with_the_chance_that_it_was_made_with(monkeypatch):
    """Two rollouts of many streams: in the second some decisions are older than the networks."""
    agent = make("dac", rollout=10**6, batch_size=8, epochs=2, learning_rate=0.05)
    lives = Lives(agent, 8, 3)
    agent.settings = replace(agent.settings, rollout=lives.decisions // 2, rollout_per_env=1)
    taught = spy(agent, monkeypatch)
    lives.run()
    kept = taught["choices"].log_probability.exp().numpy()
    assert np.exp(taught["high", "old"][: len(kept)]) == pytest.approx(kept, rel=1e-5)
    with torch.no_grad():
        rollout, choices = taught["rollout"], taught["choices"]
        now = agent.heads.compute_option_choice(rollout.observation, choices.former).numpy()
    assert np.abs(now[np.arange(len(kept)), choices.option] - kept).max() > 0.05


@pytest.mark.nightly_for("ppoc-settings1", "dac-settings0")
@pytest.mark.parametrize(("name", "settings"), [("dac", {}), ("ppoc", {"least_samples": 32})])
def test_with_one_option_it_is_ppo_in_many_rooms_to_the_bit(name, settings):
    arguments = {"primitives": 600, "seed": 1, "eval_every": 300, "eval_episodes": 1}
    one = train("ppo", make_rooms(), settings=SMALL, **arguments)
    other = train(name, make_rooms(), settings=SMALL | {"options": 1} | settings, **arguments)
    assert [e.mean_return for e in one.evaluations] == [e.mean_return for e in other.evaluations]
    for key in ("policy", "critic"):
        assert torch.equal(getattr(one.agent, key).weights, other.agent.heads.networks[key].weights), key


@pytest.mark.nightly_for("ppoc-AutoresetMode.NEXT_STEP", "dac-AutoresetMode.DISABLED", "dac-AutoresetMode.SAME_STEP")
@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", ["dac", "ppoc"])
def test_no_outcome_shows_the_next_episode_and_no_option_goes_on_into_it(name, mode):
    env = SyncVectorEnv([Counting] * 3, autoreset_mode=mode)
    settings = {"rollout": 30, "rollout_per_env": 1, "epochs": 1, "hidden": (4,), "scale_observations": False}
    agent = make_agent(name, env.single_observation_space, env.single_action_space, 0, **settings)
    learned, learn = [], agent._learn
    agent._learn = lambda rollout, choices: (learned.append((rollout, choices)), learn(rollout, choices))[1]
    train(agent, env, primitives=200, eval_env=Counting(), eval_episodes=0)
    rows = 0
    for rollout, choices in learned:
        (episode, step), (next_episode, next_step) = rollout.observation.T, rollout.next_observation.T
        assert torch.equal(episode, next_episode) and torch.equal(next_step, step + 1)
        assert torch.equal(rollout.over, next_step == 2 + episode % 3)
        assert torch.equal(choices.former == NONE, step == 0) and bool(choices.is_chosen[step == 0].all())
        rows += len(step)
    assert rows > 150


def test_episodes_that_are_dropped_count_as_truncated_and_options_do_not_go_on():
    agent = make("dac", rollout=10**6)
    Lives(agent, 8, 0).run()
    before, _ = agent._many[0].gather()
    last = find_last(before)
    agent.begin_episodes(8, CPU)
    after, _ = agent._many[0].gather()
    assert torch.equal(after.over, before.over | last) and bool((last & ~before.over).any())
    agent.act(Moments(torch.arange(8), torch.zeros(8, 5), torch.ones(8, ACTIONS, dtype=torch.bool)))
    assert (agent._many[1].state_dict()["former"] == NONE).all()


def test_a_rollout_that_has_begun_is_saved_and_goes_on():
    agent, fresh = make("dac", rollout=10**6), make("dac", rollout=10**6)
    Lives(agent, 8, 0).run()
    fresh.begin_episodes(8, CPU)
    fresh._many[0].load_state_dict(agent._many[0].state_dict())
    assert len(fresh._many[0]) == len(agent._many[0]) > 8
    for now, before in zip(fresh._many[0].gather(), agent._many[0].gather(), strict=True):
        assert all(torch.equal(a, b) for a, b in zip(now, before, strict=True))
    fresh._many[0].take()
    again = make("dac", rollout=10**6)
    again.begin_episodes(8, CPU)
    again._many[0].load_state_dict(fresh._many[0].state_dict())
    assert len(again._many[0]) == 0


def test_a_rollout_of_many_streams_is_cut_into_as_many_minibatches_as_one_of_one():
    agent = make("dac", rollout=64, batch_size=16, epochs=1)
    assert [len(rows) for rows in agent._draw_batches(64, 64)] == [16] * 4
    assert [len(rows) for rows in agent._draw_batches(512, 512)] == [128] * 4


def test_an_agent_that_learned_from_many_goes_on_in_one_environment_as_any_other():
    """What was kept of streams plays no part in it."""
    many = train("dac", make_rooms(), primitives=300, seed=1, settings=SMALL, eval_episodes=0).agent
    seen = []
    learn = many._learn
    many._learn = lambda rollout, choices: (seen.append((rollout, choices)), learn(rollout, choices))[1]
    env = gymnasium.make("hrl_escape/PaperOneButton-v1", observation="features")
    train(many, env, primitives=SMALL["rollout"], eval_episodes=0)
    ((rollout, choices),) = seen
    assert len(choices.option) == SMALL["rollout"] and choices.log_probability is None
    assert torch.equal(rollout.stream, torch.zeros_like(choices.option))
    train(many, make_rooms(), primitives=200, eval_episodes=0)
    rollout, _ = seen[1]
    assert [int(at) for at in rollout.place[rollout.stream == 3]] == list(range(int((rollout.stream == 3).sum())))
