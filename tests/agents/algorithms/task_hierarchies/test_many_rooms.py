"""Task hierarchies in many environments at once: exact values, calls of one's own in each stream, resumed bits."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.agents import evaluate, load_agent, make_agent, train
from hrl_escape.agents.algorithms.intra_option_q import IntraOptionQ
from hrl_escape.agents.algorithms.sarsa import Sarsa
from hrl_escape.agents.algorithms.task_hierarchies.h_dqn import HDqn
from hrl_escape.agents.algorithms.task_hierarchies.hdg import Hdg
from hrl_escape.agents.algorithms.task_hierarchies.hq_learning import HqLearning
from hrl_escape.agents.algorithms.task_hierarchies.maxq_q import MaxqQ
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.hierarchy.goal_space import GoalSet
from hrl_escape.agents.hierarchy.runner import StackAgent
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Hierarchy
from hrl_escape.agents.hierarchy.task_graph import maxq
from hrl_escape.agents.registry import get_agent_class, list_hierarchy_agents, list_many_env_agents
from hrl_escape.agents.single_env import serve_many
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import AgentSettingsError, UnsupportedError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from tests.agents.algorithms.test_exact_smdps import (
    EXACT,
    GAMMA,
    GRAPH_MAKERS,
    MODELS,
    READ,
    find_distances,
    look,
    make,
    make_env,
    make_graph,
    make_learner,
    pay_for,
    solve_graph,
)
from tests.agents.running import interact
from tests.agents.small_envs import solve
from tests.agents.training.test_many_envs import Interrupted, InterruptedRooms
from tests.agents.training.test_resuming import flatten

GIVEN = [kind for kind in READ if kind.__module__.startswith("hrl_escape.agents.algorithms.task_hierarchies")]


class Nest(BaseTask):
    """Calls itself by its first choice."""

    def decode(self, choice, seen, context):
        return Call(choice) if choice else Call(self)


class Told(gymnasium.Wrapper):
    """Tells what a vector environment can: durations, masks, and rewards discounted already."""

    def reset(self, **given):
        observation, info = super().reset(**given)
        return observation, {"action_mask": info["action_mask"], "duration": 0, "discounted_reward": 0.0}

    def step(self, action):
        *rest, info = super().step(action)
        discounted = float(sum(GAMMA**n * reward for n, reward in enumerate(info["rewards"])))
        return *rest, {"action_mask": info["action_mask"], "duration": info["duration"],
                       "discounted_reward": discounted, "discount": GAMMA ** info["duration"]}


SETTINGS = {"h-uct": {"simulations": 3, "depth": 5}, "h-dqn": {"hidden": (8,), "worker_warmup": 50, "batch_size": 2}}


def teach_many(agent, count, seed, primitives, longest=12):
    primitives = primitives // 3 if count == 1 else primitives
    many = SyncVectorEnv([lambda: Told(make_env(seed, longest))] * count, autoreset_mode=AutoresetMode.SAME_STEP)
    return train(agent, many, eval_env=make_env(seed), primitives=primitives, eval_episodes=0, seed=seed).agent


@pytest.mark.nightly_for("RMaxq-64", "MacroQ-64", "FeudalRl-64", "MaxqQ-64")
@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.slow), 64])
@pytest.mark.parametrize("agent_class", GIVEN)
def test_values_of_choices_are_exact(agent_class, count):
    env = make_env(1)
    primitives = 20_000 if count == 1 else 6_000
    agent = teach_many(make(agent_class, env, MODELS.get(agent_class, EXACT)), count, 1, primitives)
    for state, row in enumerate(solve(env.smdp, GAMMA)):
        legal = np.isfinite(row)
        if legal.sum() > 1:  # a program has no choice point elsewhere
            assert READ[agent_class](agent, look(env, state))[legal] == pytest.approx(row[legal], abs=2e-6), state


@pytest.mark.nightly
@pytest.mark.nightly_for("1")
@pytest.mark.parametrize("count", [1, 64])
def test_ways_and_distances_to_goals_are_exact(count):
    env = make_env(0)
    goals = GoalSet(4, lambda observation, goal: observation == goal)
    settings = {"gamma": GAMMA, "values": "table", "table_learning_rate": 1.0, "patience": 3, "worker_warmup": 10**9,
                "worker_epsilon_end": 1.0}
    feudal = teach_many(make(HDqn, env, settings, goals=goals), count, 0, 6_000)
    hdg = teach_many(make(Hdg, env, EXACT | {"dead_end": 30.0}), count, 0, 6_000)
    numbers = [hdg.find_number(env.observe(state)) for state in range(len(env.smdp))]
    for goal in range(4):
        paid, lengths = solve(pay_for(env.smdp, goal), GAMMA), find_distances(env.smdp, goal)
        for state in set(range(len(env.smdp))) - {goal}:
            legal = np.isfinite(paid[state])
            assert feudal.worker.compute(env.observe(state), goal)[legal] == pytest.approx(paid[state][legal], abs=1e-9)
            assert hdg.distances[numbers[state], numbers[goal]][legal] == pytest.approx(lengths[state][legal])


@pytest.mark.nightly_for("stack-1", "stack-64", "r-maxq-64")
@pytest.mark.parametrize(("name", "count"), [("r-maxq", 64), ("stack", 1), ("stack", 64)])
def test_tasks_are_worth_what_they_earn_in_streams_that_each_have_their_own_calls(name, count):
    env = make_env(2, longest=40)
    agent = teach_many(GRAPH_MAKERS[name](env), count, 2, 9_000, longest=40)
    inner, outer = solve_graph(env.smdp)
    for state, row in enumerate(inner if name == "stack" else outer):
        legal, seen = np.isfinite(row), look(env, state)
        found = (agent.learners["below"].compute_values(seen.observation) if name == "stack" else
                 READ[type(agent)](agent, seen))
        assert found[legal] == pytest.approx(row[legal], abs=2e-6), state


@pytest.mark.nightly
def test_one_stream_learns_what_one_environment_teaches():
    for name in list_hierarchy_agents():
        env, agents = make_env(1), []
        for _ in range(2):
            kind = get_agent_class(name)
            agents.append(kind(env.observation_space, env.action_space, 0, kind.Settings(**SETTINGS.get(name, {}))))
        alone, streamed = agents
        served = serve_many(streamed)
        served.begin_episodes(1, torch.device("cpu"))
        for transition in interact(alone, make_env(1, longest=10**9), 150):
            decision = Decisions(*(torch.from_numpy(np.array([getattr(transition, field, 0)]))
                                   for field in Decisions._fields[:-1]))
            action = served.act(Moments(decision.env, decision.observation, decision.action_mask))
            assert int(action) == transition.action, name
            served.observe(decision)
        expected, found = alone.state_dict(), streamed.state_dict()
        (episode,) = found.pop("episodes", [{}])
        assert flatten(found | episode) == flatten(expected), name


def test_networks_of_two_levels_learn_as_often_from_every_decision_in_fewer_updates():
    env, drawn = make_rooms(), {}
    agent = make_agent("h-dqn", env.single_observation_space, env.single_action_space, 0, hidden=(8,), patience=5,
                       worker_warmup=0, batch_size=4, updates_per_decision=0.5)
    for name, level in (("manager", agent.manager), ("worker", agent.worker)):
        sample = level._replay.sample

        def note(size, name=name, sample=sample):
            drawn.setdefault(name, []).append(size)
            return sample(size)

        level._replay.sample = note
    train(agent, env, primitives=400, eval_episodes=0)
    assert max(drawn["worker"]) == 4 * 4, "eight rooms, half an update for each decision, of four backups"
    assert len(drawn["worker"]) <= 400 // 8
    assert abs(sum(drawn["worker"]) - 4 * 0.5 * 400) <= 4 * 4 and drawn["manager"]


@pytest.mark.nightly
def test_trials_are_those_of_each_stream():
    env = make_env(1)
    settings = {"gamma": GAMMA, "agents": 1, "learning_rate": 1.0, "trace": 0.0, "epsilon_start": 1.0,
                "epsilon_end": 1.0, "temperature": 1e6}
    agent = teach_many(make(HqLearning, env, settings), 64, 1, 30_000)
    for state, row in enumerate(solve(env.smdp, GAMMA)):  # one agent without traces is a Q-learner by trials
        legal = np.isfinite(row)
        found = agent.tables[0].get_values(agent._discretise(env.observe(state)))
        assert found[legal] == pytest.approx(row[legal], abs=2e-6), state


# --- training -------------------------------------------------------------------------------------------


def make_rooms(count=8):
    return EscapeRoomVectorEnv(count, "paper-one-button", observation="features", output="torch")


class InterruptedOptions(Interrupted, BatchedOptionsEnv):
    """Options, which are cut off before they have ended."""


OWNERS = ("maxq-q", "hamq", "hq-learning")
"""Agents that keep more of an episode than running calls."""


@pytest.mark.nightly_for("smdp-hq-learning", "smdp-maxq-q", "maxq-q", "smdp-hamq")
@pytest.mark.parametrize("name", [
    *(pytest.param(name, marks=() if name == "maxq-q" else pytest.mark.slow) for name in list_hierarchy_agents()),
    *(f"smdp-{name}" for name in OWNERS)])
def test_a_run_cut_off_resumes_to_the_same_bits(tmp_path, name, monkeypatch):
    def make():
        if name.startswith("smdp-"):
            return InterruptedOptions(4, "paper-one-button", observation="features", include_primitives=False,
                                      discount=0.99)
        return InterruptedRooms(8, "paper-one-button", observation="features")

    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 128)
    arguments = {"primitives": 400, "seed": 1, "eval_every": 200, "eval_episodes": 1, "checkpoint_seconds": 0.0,
                 "settings": SETTINGS.get(name, {})}
    whole, env = train(name, make(), out=tmp_path / "whole", **arguments), make()
    env.left = 20
    with pytest.raises(KeyboardInterrupt):
        train(name, env, out=tmp_path / "cut", **arguments)
    resumed = train(name, make(), out=tmp_path / "cut", **arguments)
    assert resumed == whole and flatten(resumed.agent.state_dict()) == flatten(whole.agent.state_dict())
    again, single = load_agent(tmp_path / "cut"), make().make_single_env()
    assert evaluate(again, single, 1) == evaluate(whole.agent, single, 1)


def test_all_of_them_learn_from_many_environments_and_calls_of_streams_are_no_single_environments():
    assert set(list_hierarchy_agents()) <= set(list_many_env_agents())
    env = make_rooms()
    agent = make_agent("maxq-q", env.single_observation_space, env.single_action_space, 0)
    train(agent, env, primitives=100, eval_episodes=0)
    assert agent.stack == () and agent.moment is None


def test_what_only_some_streams_log_is_a_mean_over_these():
    class Telling(MaxqQ):
        def learn(self, step, returns):
            return {"always": 1.0} | ({"seldom": 6.0} if self._env == 2 else {})

    env = make_env(0)
    agent = make(Telling, env)
    served = serve_many(agent)
    served.begin_episodes(4, torch.device("cpu"))
    rows, mask = torch.arange(4), torch.ones((4, 3), dtype=torch.bool)
    action, zeros = served.act(Moments(rows, rows, mask)), torch.zeros(4)
    flags = torch.zeros(4, dtype=torch.bool)
    told = served.observe(Decisions(rows, rows, mask, action, zeros, zeros, torch.ones(4, dtype=torch.int64),
                                    zeros + GAMMA, rows, mask, flags, flags))
    assert told == {"always": 1.0, "seldom": 6.0}


def test_tasks_that_share_a_learner_keep_their_open_decisions_apart():
    """The root's decision stays open while tasks below make theirs; both mask what the other may do."""
    env = make_env(2, longest=40)
    hierarchy = maxq({"root": ["below", 0, 1], "below": [1, 2, 0]}, {"below": lambda seen: seen.observation == 3},
                     learners={"root": make_learner})
    shared = dataclasses.replace(hierarchy, share={"below": "root"})
    agent = StackAgent(shared, env.observation_space, 0, StackAgent.Settings(gamma=GAMMA))
    masks, told = {}, []
    learner = agent.learners["root"]
    act, observe = learner.act, learner.observe

    def note(observation, mask):
        masks[learner._env] = mask.tolist()
        return act(observation, mask)

    def check(transition):
        told.append(learner._env % 2)
        assert transition.action_mask.tolist() == masks[learner._env]
        return observe(transition)

    learner.act, learner.observe = note, check
    teach_many(agent, 4, 2, 400, longest=40)
    assert set(told) == {0, 1} and set(masks) == set(range(8))


def test_learners_that_know_one_environment_and_tasks_that_call_themselves_are_refused():
    env = make_env(0)
    online = maxq({"root": [0, 1, 2]}, {}, learners={
        "root": lambda views, choices, seed: Sarsa(views, choices, seed, Sarsa.Settings(replay_capacity=0))})
    with pytest.raises(AgentSettingsError, match="replay_capacity"):
        teach_many(StackAgent(online, env.observation_space, 0), 2, 0, 10)
    single = make_graph(learners={"root": IntraOptionQ})
    with pytest.raises(AgentSettingsError, match="task root.*many environments at once"):
        teach_many(StackAgent(single, env.observation_space, 0), 2, 0, 10)
    with pytest.raises(UnsupportedError, match="'nest' calls itself"):
        teach_many(StackAgent(Hierarchy(nest := Nest("nest", 3), learners={nest.name: make_learner}),
                              env.observation_space, 0), 2, 0, 40)
