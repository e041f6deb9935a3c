"""HRC: costs of interventions against a simulation told as a story, and what the agent spends in puzzles."""

import itertools
from functools import cache

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.algorithms.structure.hrc import (
    TASK_END,
    Hrc,
    HrcSettings,
    compute_intervention_probabilities,
)
from hrl_escape.benchmark.solved_probe import find_edges_that_matter
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError
from tests.agents.puzzle_envs import make_button_env
from tests.agents.running import interact

CHAIN = {n: [n - 1] if n else [] for n in range(8)}
TREE = {n: [(n - 1) // 2] if n else [] for n in range(10)}
LAYERED = {0: [], 1: [], 2: [], 3: [0, 1], 4: [1, 2], 5: [0, 2], 6: [3, 4], 7: [4, 5], 8: [6]}


def find_causes(parents, goal):
    """Everything that a goal depends on, directly or not, itself left out."""
    found, waiting = set(), list(parents.get(goal, ()))
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += parents.get(node, ())
    return frozenset(found)


def compute_expected_cost(parents, goal, rule, gate="and"):
    """Exact expectation over sets of interventions: cost as `Hrc.cost` counts it, and interventions."""
    ancestors = find_causes(parents, goal)
    test = all if gate == "and" else any

    def list_reachable(made):
        return [node for node, needs in parents.items() if not needs or test(need in made for need in needs)]

    @cache
    def expect(made):
        before = list_reachable(made)
        if goal in before:
            return 0.0, 0.0
        candidates = [node for node in before if node not in made]
        cost = count = 0.0
        shares = compute_intervention_probabilities(candidates, ancestors, len(made), rule)
        for node, probability in zip(candidates, shares, strict=True):
            if probability:
                after = made | {node}
                joined = len(list_reachable(after)) - len(before)
                later, more = expect(after)
                cost += probability * (joined * (len(after) + 1) + later)
                count += probability * (1 + more)
        return cost, count

    return expect(frozenset())


def simulate(parents, goal, rule, gate, rng):
    """One search: cost and interventions."""
    ancestors, made, cost = find_causes(parents, goal), [], 0

    def can_reach(node):
        on = [need in made for need in parents[node]]
        return not on or (all(on) if gate == "and" else any(on))

    reachable = {node for node in parents if can_reach(node)}
    while goal not in reachable:
        free = sorted(reachable - set(made))
        wanted = [node for node in free if node in ancestors]
        others = [node for node in free if node not in ancestors]
        if rule == "uniform" or not wanted or not others:
            group = free
        elif rule == "ancestors" or rng.random() < len(made) / (len(made) + 1):
            group = wanted
        else:
            group = others
        made.append(group[rng.integers(len(group))])
        for node in parents:
            if node not in reachable and can_reach(node):
                reachable.add(node)
                cost += len(made) + 1
    return cost, len(made)


@pytest.mark.parametrize("rule", ["uniform", "targeted", "ancestors"])
@pytest.mark.parametrize(("parents", "gate"), [(CHAIN, "and"), (TREE, "and"), (LAYERED, "and"), (LAYERED, "or")])
def test_expected_costs_are_those_of_a_simulation(parents, gate, rule):
    goal, rng = max(parents), np.random.default_rng(0)
    runs = np.array([simulate(parents, goal, rule, gate, rng) for _ in range(1_500)])
    exact = compute_expected_cost(parents, goal, rule, gate)
    error = 4 * runs.std(axis=0) / len(runs) ** 0.5 + 1e-9
    assert (np.abs(runs.mean(axis=0) - exact) < error).all()


def test_a_chain_costs_the_same_by_any_rule_and_a_tree_does_not():
    n = 20
    chain = {node: [node - 1] if node else [] for node in range(n)}
    for rule in ("uniform", "targeted", "ancestors"):
        assert compute_expected_cost(chain, n - 1, rule) == pytest.approx((n * (n + 1) / 2 - 1, n - 1))
    tree = [compute_expected_cost(TREE, 9, rule) for rule in ("uniform", "targeted", "ancestors")]
    assert tree[0] == pytest.approx((29.472, 5.75), abs=1e-3)
    assert tree[1] == pytest.approx((21.630, 4.068), abs=1e-3)
    assert tree[2] == (14.0, 3.0)


# --- the agent ----------------------------------------------------------------------------


def play(agent, env, decisions, seed):
    """Train until so many decisions; returns the number of escapes."""
    return sum(step.terminated for step in interact(agent, env, decisions, seed))


@pytest.mark.nightly_for("layered-reset", "tree-reset", "chain-reset", "tree-ignore", "chain-ignore")
@pytest.mark.parametrize("rule", ["ignore", "reset"])
@pytest.mark.parametrize("kind", ["chain", "tree", "layered"])
def test_it_finds_the_way_out_and_the_edges_that_matter(kind, rule):
    for seed in range(3):
        env = make_button_env(kind, 7, rule, seed)
        agent = Hrc(env.observation_space, env.action_space, seed, HrcSettings())
        assert play(agent, env, 700, seed) > 5
        edges = {(parent - 2, child - 2) for parent, child in agent.get_graph()}
        goals = (env.puzzle.goal,)
        assert find_edges_that_matter(edges, goals) == find_edges_that_matter(env.puzzle.edges, goals)


def count_parents(puzzle):
    """The buttons' parents, and the exit behind the goal."""
    parents = {node: [p for p, child in puzzle.edges if child == node] for node in range(len(puzzle.target_names))}
    return parents | {len(parents): [puzzle.goal]}


@pytest.mark.nightly
def test_its_cost_lies_below_that_of_subgoals_tried_one_by_one():
    """Bits that were turned on in trying stay on, so that more than the chosen ones are."""
    spent, expected = [], []
    for seed in range(12):
        env = make_button_env("tree", 9, "ignore", seed)
        parents = count_parents(env.puzzle)
        agent = Hrc(env.observation_space, env.action_space, seed, HrcSettings())
        play(agent, env, 150, seed)
        assert TASK_END in agent._effects
        spent.append(agent.cost)
        expected.append(compute_expected_cost(parents, len(parents) - 1, "uniform")[0])
    assert 0.4 * np.mean(expected) < np.mean(spent) < 0.9 * np.mean(expected)


def test_an_action_counts_as_tried_only_where_all_that_was_chosen_is_on_and_anew_when_nothing_is_left():
    agent = Hrc(spaces.MultiBinary(4), spaces.Discrete(2), 0, HrcSettings())
    agent._effects, agent._parents, agent.interventions = {0: 0}, {0: [()]}, [0]
    agent._learn((0b0000, 1, 0b0000, False))
    assert agent._list_untried().tolist() == [False, True]
    agent._learn((0b0001, 1, 0b0001, False))
    assert not agent._list_untried().any()
    agent.act(np.array([1.0, 0.0, 0.0, 0.0]), np.ones(2, np.bool_))
    assert agent._list_untried().tolist() == [False, True], "some action must have failed by chance"


class TreeOfBits(gymnasium.Env):
    """Twenty bits; an action turns its bit on where its parent is on, the last one ends the task where the goal is."""

    observation_space, action_space = spaces.MultiBinary(20), spaces.Discrete(21)

    def __init__(self, goal):
        self.goal = goal

    def reset(self, *, seed=None, options=None):
        self.bits = np.zeros(20, np.int8)
        return self.bits.copy(), {}

    def step(self, action):
        if action < 20 and (action == 0 or self.bits[(action - 1) // 2]):
            self.bits[action] = 1
        return self.bits.copy(), -1.0, bool(action == 20 and self.bits[self.goal]), False, {}


def test_before_the_goal_is_reached_the_data_are_the_same_whichever_subgoal_it_is():
    """So no estimate of effects can prefer its ancestors: what the paper's rule goes by has to be told."""
    ways = []
    for goal in range(15, 20):
        agent = Hrc(TreeOfBits.observation_space, TreeOfBits.action_space, 0, HrcSettings())
        play(agent, TreeOfBits(goal), 400, 0)
        ways.append([sample for sample in itertools.takewhile(lambda sample: not sample[3], agent._samples)])
    for one, other in itertools.combinations(ways, 2):
        common = min(len(one), len(other))
        assert common > 20 and one[:common] == other[:common]
    for rule in ("targeted", "ancestors"):
        with pytest.raises(AgentSettingsError, match="ancestors"):
            HrcSettings(rule=rule)


def test_a_hint_is_followed():
    agent = Hrc(spaces.MultiBinary(4), spaces.Discrete(4), 0, HrcSettings(rule="ancestors", ancestors=(2,)))
    agent._effects, agent._parents = {0: 0, 1: 1, 2: 2}, {0: [()], 1: [()], 2: [()]}
    agent._tried = {(3, 0): 1}
    assert agent.act(np.zeros(4), np.ones(4, np.bool_)) == 2
    assert agent.interventions == [2]


def test_parents_are_the_smallest_set_on_in_successes_and_in_the_fewest_failures():
    agent = Hrc(spaces.MultiBinary(4), spaces.Discrete(2), 0, HrcSettings())
    agent._effects[3] = 0
    for before, works in ((0b0111, True), (0b0011, True), (0b0001, False), (0b0010, False), (0b0110, False)):
        agent._samples.append((before, 0, before | 0b1000 * works, False))
    assert agent._find_parents(3) == [(0, 1)]
    agent._samples.append((0b0011, 0, 0b0011, False))
    assert agent._find_parents(3) == [(0, 1)], "a failure by chance"


@pytest.mark.nightly
def test_actions_that_fail_are_tried_again():
    for seed in range(3):
        env = make_button_env("tree", 6, "ignore", seed, failure=0.2)
        agent = Hrc(env.observation_space, env.action_space, seed, HrcSettings(tries=2))
        assert play(agent, env, 600, seed) > 5


def test_it_resumes_to_the_bit_and_refuses_what_has_no_bits():
    env = make_button_env("tree", 6, "ignore", 0)
    agent = Hrc(env.observation_space, env.action_space, 0, HrcSettings())
    play(agent, env, 25, 0)
    other = Hrc(env.observation_space, env.action_space, 0, HrcSettings())
    other.load_state_dict(agent.state_dict())
    assert other.get_graph() == agent.get_graph() and other.interventions == agent.interventions
    play(agent, env, 60, 1)
    play(other, make_button_env("tree", 6, "ignore", 0), 60, 1)
    assert other._samples == agent._samples
    with pytest.raises(UnsupportedSpaceError, match="bits"):
        Hrc(spaces.MultiDiscrete([3, 2]), spaces.Discrete(2), 0)
