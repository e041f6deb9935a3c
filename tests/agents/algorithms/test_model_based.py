"""Agents that learn models: exact where everything is known, economical where it is not, and right about parents."""

import json
from collections import Counter

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.agent import SMDPTransition, make_transition
from hrl_escape.agents.algorithms.factored_r_max import FactoredRMax, FactoredRMaxSettings
from hrl_escape.agents.algorithms.r_max import RMax, RMaxSettings
from hrl_escape.agents.factored.planning_agent import DurationHistory, FactoredModel, fit_durations
from hrl_escape.agents.factored.structure import StructureLearner
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.training.train import train
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.graphs import find_ancestors
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.benchmark import load_benchmark
from tests.agents.puzzle_envs import PuzzleEnv, learn_puzzle, make_button_env
from tests.agents.running import interact, learn

GAMMA = 0.9


class BitFlipEnv(gymnasium.Env):
    """BitFlip, enumerated: any bits to begin with, one primitive a flip, -1 each and 20 more once all bits are on."""

    def __init__(self, bits=4):
        self.puzzle, self.bits = BitFlipPuzzle(bits), bits
        self.observation_space, self.action_space = spaces.MultiBinary(bits), spaces.Discrete(bits)

    def observe(self, state):
        return np.array(self.puzzle.observe(state), np.int8)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(2**self.bits - 1))
        return self.observe(self.state), {}

    def step(self, action):
        self.state = self.puzzle.update(self.state, Contacts((int(action),)))
        solved = self.puzzle.is_solved(self.state)
        return self.observe(self.state), -1.0 + 20.0 * solved, solved, False, {}


def solve_bit_flip(env):
    """Optimal Q of every state that is not solved, (states, actions), by value iteration to the last bit."""
    states = 2**env.bits - 1
    after = np.array([[env.puzzle.update(s, Contacts((a,))) for a in range(env.bits)] for s in range(states)])
    solved = after == states
    values = np.zeros(states + 1)
    for _ in range(2_000):
        q = np.where(solved, 19.0, -1.0 + GAMMA * values[after])
        values[:-1] = q.max(axis=1)
    return q


def solve_taxi(table):
    """Optimal Q of Taxi from its own transition table."""
    rows = np.array([[(s, r, not over) for ((_, s, r, over),) in table[n].values()] for n in table])
    after, rewards, lasting = rows[..., 0].astype(int), rows[..., 1], rows[..., 2]
    values = np.zeros(500)
    for _ in range(2_000):
        q = rewards + GAMMA * values[after] * lasting
        values = q.max(axis=1)
    return q


def list_taxi():
    """Taxi's reachable states and its table; a state in which the passenger has arrived is an end."""
    taxi = gymnasium.make("Taxi-v4").unwrapped
    states = [s for s in range(500) if (place := list(taxi.decode(s)))[2] != place[3]]
    return taxi, states


@pytest.fixture(scope="module")
def taxi():
    env, states = list_taxi()
    return env, states, solve_taxi(env.P)


def show_all_of_taxi(agent, taxi, states, observe):
    for state in states:
        for action, ((_, after, reward, over),) in taxi.P[state].items():
            mask = np.ones(6, np.bool_)
            here, there = observe(state), observe(after)
            agent.observe(SMDPTransition(here, action, mask, reward, reward, 1, GAMMA, there, mask, over, False))


@pytest.mark.nightly
def test_r_max_equals_value_iteration_on_taxi_once_all_is_known(taxi):
    env, states, exact = taxi
    settings = RMaxSettings(gamma=GAMMA, optimistic_value=20.0, tolerance=1e-12)
    agent = RMax(env.observation_space, env.action_space, 0, settings)
    assert (agent.compute_values(states[0]) == 20.0).all(), "nothing is known yet"
    show_all_of_taxi(agent, env, states, lambda state: state)
    for state in states[::9]:
        assert agent.compute_values(state) == pytest.approx(exact[state], abs=1e-9)
        best = agent.act_greedy(state, np.ones(6, np.bool_), np.random.default_rng(0))
        assert exact[state][best] == pytest.approx(exact[state].max(), abs=1e-9)


@pytest.mark.nightly
def test_factored_r_max_equals_value_iteration_on_taxi_once_all_is_known(taxi):
    env, states, exact = taxi
    settings = FactoredRMaxSettings(gamma=GAMMA, max_parents=4, conditions="any")
    agent = FactoredRMax(spaces.MultiDiscrete([5, 5, 5, 4]), env.action_space, 0, settings)
    mask = np.ones(6, np.bool_)
    show_all_of_taxi(agent, env, states, lambda state: np.array(list(env.decode(state))))
    for state in states[::9]:
        observation = np.array(list(env.decode(state)))
        assert agent.compute_plan_value(observation, mask) == pytest.approx(exact[state].max(), abs=1e-9)
        best = agent.act_greedy(observation, mask, np.random.default_rng(0))
        assert exact[state][best] == pytest.approx(exact[state].max(), abs=1e-9)


def test_factored_r_max_finds_which_numbers_of_taxi_matter_to_a_move(taxi):
    env, states, _ = taxi
    agent = FactoredRMax(spaces.MultiDiscrete([5, 5, 5, 4]), env.action_space, 0,
                         FactoredRMaxSettings(max_parents=4, conditions="any"))
    show_all_of_taxi(agent, env, states, lambda state: np.array(list(env.decode(state))))
    learner = agent.model.learner
    row, column, passenger, destination = range(4)
    south, east, pickup, dropoff = 0, 2, 4, 5
    found = {(a, f): set(learner.hypotheses[learner.get_alive(a, f)[0]]) for a in range(6) for f in range(4)}
    assert found[south, row] == {row}
    assert found[east, column] == {row, column}, "walls stand in some rows only"
    assert learner.list_active(south).tolist() == [row]
    assert {row, column, passenger} <= found[pickup, passenger]
    assert learner.over in learner.list_active(dropoff)


@pytest.mark.nightly_for("3")
@pytest.mark.parametrize("visits", [1, 3])
def test_r_max_respects_its_own_visit_bound(visits):
    """It tries what it tried less than m times, m |S| |A| times at most, and else does what its model says."""
    env = BitFlipEnv()
    exact = solve_bit_flip(env)
    agent = RMax(env.observation_space, env.action_space, 0, RMaxSettings(gamma=GAMMA, visits=visits))
    tries, explorations = Counter(), 0
    mask = np.ones(4, np.bool_)
    observation, _ = env.reset(seed=0)
    for _ in range(1_200):
        known = np.array([tries[bytes(observation), action] >= visits for action in range(4)])
        values = agent.compute_values(observation)
        assert ((values == 100.0) == ~known).all()
        action = agent.act(observation, mask)
        assert values[action] == pytest.approx(values.max(), abs=1e-6)
        explorations += not known[action]
        tries[bytes(observation), action] += 1
        transition = make_transition(observation, action, mask, env.step(action), GAMMA)
        agent.observe(transition)
        observation = env.reset()[0] if transition.terminated else transition.next_observation
    assert explorations == visits * exact.size, "and the bound is used up: every pair is known"
    rng = np.random.default_rng(0)
    for state in range(15):
        assert agent.compute_values(env.observe(state)) == pytest.approx(exact[state], abs=1e-6)
        assert exact[state, agent.act_greedy(env.observe(state), mask, rng)] == pytest.approx(exact[state].max())


@pytest.mark.nightly_for("any")
@pytest.mark.parametrize("conditions", ["all-on", "any"])
def test_factored_r_max_equals_value_iteration_on_an_enumerated_bit_flip(conditions):
    env = BitFlipEnv()
    exact = solve_bit_flip(env)
    settings = FactoredRMaxSettings(gamma=GAMMA, max_parents=3, conditions=conditions)
    agent = FactoredRMax(env.observation_space, env.action_space, 0, settings)
    for _ in interact(agent, env, 400):
        pass
    mask = np.ones(4, np.bool_)
    for state in range(15):
        assert agent.compute_plan_value(env.observe(state), mask) == pytest.approx(exact[state].max(), abs=1e-9)
        best = agent.act_greedy(env.observe(state), mask, np.random.default_rng(0))
        assert exact[state, best] == pytest.approx(exact[state].max(), abs=1e-9)
    # a bit is flipped on only where all lower bits are on
    assert agent.get_graph() == {(lower, bit) for bit in range(4) for lower in range(bit)}


@pytest.mark.nightly_for("layered-20-ignore-5000", "layered-10-reset-4000")
@pytest.mark.parametrize(
    ("kind", "buttons", "rule", "primitives"),
    [("layered", 20, "ignore", 5_000), ("layered", 10, "reset", 4_000), ("random", 10, "ignore", 3_000)],
)
def test_factored_r_max_escapes_and_recovers_every_edge_that_matters(kind, buttons, rule, primitives):
    first, precision, recall, returns = learn_puzzle(
        "factored-r-max", make_button_env(kind, buttons, rule, 1), primitives, 1)
    assert first is not None
    assert (precision, recall) == (1.0, 1.0)
    assert returns[-1] == returns[-2] > returns[0], "it has settled on a better way"


def test_where_an_action_is_masked_is_learned_like_what_it_does():
    """Behind a door the exit's action never fails when it is legal, so its mask alone says what has to be on."""
    puzzle = make_button_env("layered", 6, "ignore", 1).puzzle
    env = PuzzleEnv(puzzle, seed=1, has_door=True)
    agent = make_agent("factored-r-max", env.observation_space, env.action_space, 0)
    learn(agent, env, 200)
    again = make_agent("factored-r-max", env.observation_space, env.action_space, 0)
    again.load_state_dict(agent.state_dict())
    for learned in (agent, again):
        observation, info = env.reset()
        pressed, terminated = [], False
        while not terminated and len(pressed) < 10:
            action = learned.act_greedy(observation, info["action_mask"].astype(bool), np.random.default_rng(0))
            observation, _, terminated, _, info = env.step(action)
            pressed.append(action)
        needed = find_ancestors(puzzle.edges, puzzle.goal_targets)
        assert terminated
        assert sorted(pressed) == [*sorted(needed), env.targets]


@pytest.mark.nightly
def test_sampled_partial_models_escape_and_recover_most_edges():
    first, precision, recall, _ = learn_puzzle(
        "monte-carlo-model", make_button_env("layered", 15, "ignore", 1), 4_000, 1)
    assert first is not None
    assert min(precision, recall) >= 0.8


def test_parents_of_random_functions_are_those_that_the_function_depends_on():
    rng = np.random.default_rng(3)
    states = (np.arange(64)[:, None] >> np.arange(6)) & 1
    for _ in range(20):
        parents = sorted(rng.choice(5, 2, replace=False).tolist())
        table = rng.integers(0, 2, (2, 2, 2))  # by two parents and the bit's own value
        learner = StructureLearner(np.full(6, 2), 1, 2)
        for state in states:
            after = state.copy()
            after[5] = table[state[parents[0]], state[parents[1]], state[5]]
            learner.add(state, 0, after, False, 0)
        depends = {p for axis, p in enumerate(parents) if (np.diff(table, axis=axis) != 0).any()}
        alive = learner.get_alive(0, 5)
        assert set(learner.hypotheses[alive[0]]) == depends
        assert all(depends <= set(learner.hypotheses[h]) for h in alive)


def test_durations_follow_distance_until_a_leg_was_run():
    homes = np.array([[0.0, 0.0], [0.0, 12.0], [16.0, 0.0]])
    samples, previous = [], -1
    pose = np.array([3.0, 4.0])
    for action in (0, 1, 2, 0, 2, 1):
        duration = round(2 + np.linalg.norm(homes[action] - pose))
        samples.append((pose, action, homes[action], duration, previous))
        pose, previous = homes[action], action
    travel = fit_durations(DurationHistory(*map(np.array, zip(*samples, strict=True))), 3)
    assert travel.places.tolist() == [0, 1, 2]
    table = travel.compute_durations(np.array([8.0, 6.0]))
    assert table[-1] == pytest.approx([12, 12, 12], abs=0.05), "10 m to each, and 2 more"
    assert table[0, 1] == pytest.approx(14, abs=0.05)
    samples.append((homes[0], 1, homes[1], 40, 0))
    slow = fit_durations(DurationHistory(*map(np.array, zip(*samples, strict=True))), 3)
    assert slow.compute_durations(homes[0])[-1, 1] == pytest.approx(27), "the mean of 14 and 40, for it is at a place"


def test_what_a_cut_ended_inside_is_no_evidence():
    model = FactoredModel(spaces.MultiBinary(2), 1, 0.9, 2, "all-on", "test")
    bits, mask = np.zeros(2), np.ones(1, np.bool_)
    cut = SMDPTransition(bits, 0, mask, -1.0, -1.0, 1, 0.9, bits, mask, False, True, cut=True)
    model.record(cut)
    assert model.is_empty
    model.record(cut._replace(cut=False))
    assert not model.is_empty


def test_an_action_masked_since_it_was_done_is_no_sample():
    """Action 0 is done and masked from then on, for its place was reached; action 1 is masked wherever one looks."""
    model = FactoredModel(spaces.MultiBinary(1), 3, 0.9, 1, "all-on", "test")
    off, on = np.zeros(1), np.ones(1)
    legal = {0: np.array([True, False, True]), 1: np.array([False, False, True])}
    for before, action, after, mask in ((off, 0, on, 0), (on, 2, on, 1), (on, 2, on, 1)):
        model.record(SMDPTransition(before, action, legal[mask], -1.0, -1.0, 1, 0.9, after, legal[1], False, False))
    assert [model.learner.count_samples(action) for action in range(3)] == [1, 2, 2], "1 is masked in two states"
    model.record(SMDPTransition(on, 2, legal[0], -1.0, -1.0, 1, 0.9, on, legal[1], True, False))
    model.record(SMDPTransition(on, 2, legal[1], -1.0, -1.0, 1, 0.9, on, legal[1], False, False))
    assert model.learner.count_samples(0) == 2, "in another episode it was not done"


def test_old_durations_are_forgotten(monkeypatch):
    """Three decisions of 5 primitives after three of 50, to another place, are all that counts."""
    monkeypatch.setattr("hrl_escape.agents.factored.planning_agent.REMEMBERED_DECISIONS", 3)
    model = FactoredModel(spaces.Box(-9, 9, (2,)), 1, 0.9, 1, "all-on", "test")
    mask = np.ones(1, np.bool_)
    for duration, place in ((50, 4.0), (5, 2.0)):
        before, after = np.array([place, 0.0]), np.array([place, 1.0])
        for _ in range(3):
            model.record(SMDPTransition(before, 0, mask, -5.0, -5.0, duration, 0.5, after, mask, False, False))
    history = model.list_durations()
    assert history.durations.tolist() == [5, 5, 5] and history.actions.tolist() == [0, 0, 0]
    assert history.previous.tolist() == [0, 0, 0]
    assert history.starts.tolist() == history.ends.tolist() == [[2.0]] * 3, "numbers that are no factors"


def test_states_that_do_not_fit_into_a_word_are_refused():
    agent = make_agent("factored-r-max", spaces.MultiBinary(60), spaces.Discrete(2), 0, max_parents=0)
    mask, bits = np.ones(2, np.bool_), np.zeros(60)
    agent.observe(SMDPTransition(bits, 0, mask, -1.0, -1.0, 1, 0.99, bits, mask, False, False))
    with pytest.raises(UnsupportedSpaceError, match="at most 56 bits; these factors have 60"):
        agent.act(bits, mask)


@pytest.mark.parametrize("name", ["r-max", "factored-r-max", "monte-carlo-model"])
def test_pictures_are_refused(name):
    with pytest.raises(UnsupportedSpaceError, match="for other observations use dqn or ppo"):
        make_agent(name, spaces.Box(0, 255, (84, 84, 3), np.uint8), spaces.Discrete(2), 0)


@pytest.mark.nightly_for("switchboard-0.0")
@pytest.mark.parametrize(("rung", "planned"), [("switchboard", 0.0), ("chain-3", 1.0)])
def test_the_log_says_where_a_learner_has_no_model_to_plan_in(tmp_path, rung, planned):
    """A switch turns its neighbours too, which no two parents explain: after some exploration all is chance."""
    room = load_benchmark("ladder-1")[rung].test[0]
    flat = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room, observation="features")
    train("smdp-factored-r-max", OptionsEnv(flat, include_primitives=False), primitives=1_500, seed=0, eval_episodes=0,
          out=tmp_path / "run", progress=False)
    rows = map(json.loads, (tmp_path / "run" / "log.jsonl").read_text().splitlines())
    shares = [row["train/planned"] for row in rows if "train/planned" in row]
    assert shares[0] not in (0.0, 1.0) and shares[-1] == planned, "some of the first episode's choices were planned"
