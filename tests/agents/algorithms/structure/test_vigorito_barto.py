"""Information, splits and trees by hand, experiments against all others, LightBox, and options that need each other."""

import itertools
import math

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from scipy.stats import beta

from hrl_escape import get_preset
from hrl_escape.agents.factored.structure import GrowingSets
from hrl_escape.agents.factored.trees import TreeLearner, compute_information, find_split
from hrl_escape.agents.making import make_agent
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.light_box import LightBoxPuzzle
from tests.agents.puzzle_envs import learn_puzzle, make_button_env
from tests.agents.running import interact, learn


class Presses(gymnasium.Env):
    """The lights of a box, and an action that presses each; nothing ends, nothing is paid."""

    def __init__(self, puzzle):
        self.puzzle = puzzle
        self.observation_space = spaces.MultiBinary(puzzle.count)
        self.action_space = spaces.Discrete(puzzle.count)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.puzzle.make_state()
        return np.array(self.puzzle.observe(self.state), np.int8), {}

    def step(self, action):
        self.state = self.puzzle.update(self.state, Contacts((int(action),), float(self.np_random.random())))
        return np.array(self.puzzle.observe(self.state), np.int8), 0.0, False, False, {}


SMALL_BOX = LightBoxPuzzle(8, ((0, 4), (1, 4), (2, 5), (3, 5), (4, 6), (5, 6), (6, 7)), 7, 0.9)


def model_box(puzzle, steps, seed, is_random=False):
    """What an agent has learned of a box in so many presses, its own or random ones."""
    env = Presses(puzzle)
    agent = make_agent("vigorito-barto", env.observation_space, env.action_space, seed)
    if is_random:
        rng = np.random.default_rng(seed)
        agent.act = lambda observation, action_mask: int(rng.integers(puzzle.count))
    learn(agent, env, steps, seed)
    return agent


def measure_forecasts(agent, puzzle):
    """Share of presses in random states of a box whose effect the agent's trees foresee."""
    rng, right = np.random.default_rng(0), 0
    agent.find_skills()
    for _ in range(2_000):
        state, share = 0, rng.random()
        for light in range(puzzle.count):
            if rng.random() < share and puzzle.parent_masks[light] & ~state == 0:
                state |= 1 << light
        press = int(rng.integers(puzzle.count))
        right += agent.predict(state, press) == puzzle.update(state, Contacts((press,), 0.0))
    return right / 2_000


# --- trees --------------------------------------------------------------------------------


@pytest.mark.nightly_for("counts2")
@pytest.mark.parametrize("counts", [(0, 0), (3, 0), (2, 5)])
def test_the_information_of_a_sample_is_that_of_its_outcome_about_the_distribution(counts):
    """Entropy of the mean less the mean entropy, over the Beta distribution by quantiles."""
    off, on = (count + 0.5 for count in counts)
    chances = beta.ppf((np.arange(200_000) + 0.5) / 200_000, on, off)

    def entropy(p):
        return -sum(q * np.log(np.maximum(q, 1e-300)) for q in (p, 1 - p))

    expected = entropy(on / (on + off)) - entropy(chances).mean()
    values = np.array([*counts, 0, 0])
    assert compute_information(values, np.array(2)) == pytest.approx(expected, abs=1e-5)
    assert compute_information(values * 10, np.array(2)) < compute_information(values, np.array(2)) or not any(counts)


def test_a_leaf_is_split_by_the_bit_that_says_most_once_that_is_worth_its_parameter():
    """Eight samples; the first bit says six of them right, the second all: 8 log 2 nats."""
    results = np.array([0, 0, 0, 0, 1, 1, 1, 1])
    on = np.column_stack([[0, 0, 0, 1, 1, 1, 1, 0], results, np.ones(8)]).astype(np.bool_)
    worth = 8 * math.log(2) - math.log(8) / 2
    assert find_split(on, results, 8, worth - 1e-6) == 1
    assert find_split(on, results, 8, worth + 1e-6) is None
    assert find_split(on, results, 80, worth - 1e-6) is None, "of a larger tree a parameter costs more"
    assert find_split(on[:, [0, 2]], results, 8, 0.0) == 0
    assert find_split(on[:, [2]], results, 8, 0.0) is None
    assert find_split(on, np.zeros(8, np.int64), 8, 0.0) is None, "nothing is left to say"


def test_trees_split_leaf_by_leaf_and_only_where_it_matters():
    """The last bit goes on where the first two are, in nine cases of ten; on, it goes off whatever they are."""
    learner, rng = TreeLearner(np.full(4, 2), 1, 3.0), np.random.default_rng(0)
    for _ in range(400):
        before = rng.integers(0, 2, 4)
        after = before.copy()
        if rng.random() < 0.9:
            after[3] = 0 if before[3] else before[0] & before[1]
        learner.add(before, 0, after, False, 0)
    assert learner.list_active(0).tolist() == [3]
    assert learner.find_parents(0, 3, own=0) == learner.find_parents(0, 3) == {0, 1}
    assert learner.find_parents(0, 3, own=1) == frozenset()
    leaves = learner.get_leaves(0)
    assert sorted(leaves.paths[leaves.outcomes == 3].sum(axis=1)) == [1, 2, 3, 3]
    assert leaves.totals[leaves.outcomes == 3].sum() == leaves.totals[leaves.outcomes < 0].sum() == 400
    held = leaves.counts.reshape(len(leaves.outcomes), 2, 4, -1).sum(axis=1)
    assert (held == leaves.totals[:, None]).all(), "each factor is on or off"
    (turned_on,) = [leaf for leaf in learner.list_changes(0) if leaves.totals[leaf].argmax() == 1]
    assert set(leaves.paths[turned_on].nonzero()[0]) == {0, 1, 4 + 3}


def test_the_gain_of_an_action_is_what_its_leaves_expect_of_the_rarest_value():
    """Two bits; the action has turned the first on from (0, 0) twice, and the second has never changed."""
    learner = TreeLearner(np.full(2, 2), 2, 100.0)
    for _ in range(2):
        learner.add(np.array([0, 0]), 0, np.array([1, 0]), False, 0)
    found = learner.compute_gains(np.array([[0, 0], [0, 1], [1, 1]], np.bool_))

    def tell(*counts):
        return float(compute_information(np.array(counts), np.array(2)))

    unseen = tell(0, 0)
    assert tell(2, 0) == pytest.approx(tell(0, 2)) and tell(2, 0) < unseen
    bonus = float(compute_information(np.zeros(8, np.int64), np.array(2)))
    assert bonus == pytest.approx(unseen)
    assert found[:, 0] == pytest.approx([4 * tell(2, 0), 4 * unseen, 4 * unseen], abs=1e-6)
    assert found[:, 1] == pytest.approx([4 * unseen] * 3, abs=1e-6), "of four outcomes, none was seen to change"


# --- sets that grow -----------------------------------------------------------------------


def show(learner, rows):
    for before, after in rows:
        learner.add(np.array(before), 0, np.array(after), False, 0)


def test_a_parent_is_taken_in_where_the_history_is_worth_its_parameters_and_dropped_again():
    """Two bits; the action turns the second on where the first is. A context has a parameter for each own value."""
    learner = GrowingSets(np.array([2, 2]), 1, 1, all_on=True)
    on, off = ((1, 0), (1, 1)), ((0, 0), (0, 0))
    show(learner, [on, off] * 3)
    parent = learner.hypotheses.index((0,))
    found = learner.compute_criteria(0, 1, np.array([0, parent]))
    assert found == pytest.approx([6 * math.log(0.5) - math.log(6), -2 * math.log(6)])
    assert learner.get_alive(0, 1)[0] == parent
    show(learner, [((1, 0), (1, 0)), ((0, 0), (0, 1))] * 2)
    found = learner.compute_criteria(0, 1, np.array([0, parent]))
    surprise = 3 * math.log(0.6) + 2 * math.log(0.4)
    assert found == pytest.approx([10 * math.log(0.5) - math.log(10), 2 * surprise - 2 * math.log(10)])
    assert learner.get_alive(0, 1)[0] == 0, "it says too little"


def test_a_parent_that_others_explain_away_is_dropped():
    """The last bit follows the second and the third; the first says the most alone, and nothing beside these two."""
    learner = GrowingSets(np.full(4, 2), 1, 3, all_on=True)
    seen = {(1, 1, 1): 10, (0, 1, 1): 1, (0, 0, 0): 5, (0, 1, 0): 5, (0, 0, 1): 5, (1, 0, 0): 1, (1, 1, 0): 1,
            (1, 0, 1): 1}
    show(learner, [((*bits, 0), (*bits, bits[1] & bits[2])) for bits, times in seen.items() for _ in range(times)])
    alone = learner.compute_criteria(0, 3, np.arange(1, 4))
    assert [learner.hypotheses[number] for number in range(1, 4)] == [(0,), (1,), (2,)] and alone.argmax() == 0
    assert learner.hypotheses[learner.get_alive(0, 3)[0]] == (1, 2)


def test_only_one_parent_more_is_tried_and_two_are_found_one_after_the_other():
    learner = GrowingSets(np.full(5, 2), 1, 2, all_on=True)
    assert [len(learner.hypotheses[number]) for number in learner.get_alive(0, 4)] == [0, 1, 1, 1, 1, 1]
    rng = np.random.default_rng(0)
    sizes = []
    for _ in range(60):
        before = np.r_[rng.integers(0, 2, 4), 0]
        after = np.r_[before[:4], before[1] & before[3]]
        learner.add(before, 0, after, False, 0)
        sizes.append(len(learner.hypotheses[learner.get_alive(0, 4)[0]]))
    assert learner.hypotheses[learner.get_alive(0, 4)[0]] == (1, 3)
    assert set(sizes) == {0, 1, 2}, "by way of one"


def test_a_set_that_explains_much_less_is_tried_no_further():
    """In a context of its own an untried parent could still decide; one that was off in successes could not."""
    learner = GrowingSets(np.full(3, 2), 1, 2, all_on=True)
    rows = [((1, 0, 0), (1, 0, 1)), ((0, 0, 0), (0, 0, 0))]
    show(learner, rows)
    believed = learner.hypotheses.index((0,))
    assert learner.get_alive(0, 2)[0] == believed
    assert {learner.hypotheses[number] for number in learner.get_alive(0, 2)} > {(0, 1)}
    show(learner, rows * 6)
    assert (0, 1) not in {learner.hypotheses[number] for number in learner.get_alive(0, 2)}


# --- the agent ----------------------------------------------------------------------------


@pytest.mark.nightly_for(
    "layered-reset-trees", "chain-ignore-trees", "tree-ignore-trees", "layered-reset-sets", "chain-ignore-sets")
@pytest.mark.parametrize("models", ["trees", "sets"])
@pytest.mark.parametrize(("kind", "rule"), [("tree", "ignore"), ("layered", "reset"), ("chain", "ignore")])
def test_it_finds_the_edges_that_matter_and_escapes(kind, rule, models):
    env = make_button_env(kind, 5, rule, 1)
    learned = learn_puzzle("vigorito-barto", env, 5_000 if models == "trees" else 1_500, 1, models=models)
    assert (learned.precision, learned.recall) == (1.0, 1.0)
    assert learned.first_escape is not None
    assert models == "sets" or learned.returns[-1] > 0, "when nothing is left to find out it escapes"


@pytest.mark.nightly
def test_a_small_box_is_modelled_exactly_and_by_random_presses_it_is_not():
    agent = model_box(SMALL_BOX, 1_500, 0)
    assert agent.get_graph() == set(SMALL_BOX.edges)
    assert measure_forecasts(agent, SMALL_BOX) > 0.98
    blind = model_box(SMALL_BOX, 1_500, 0, is_random=True)
    assert len(blind.get_graph() & set(SMALL_BOX.edges)) <= 4


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_published_box_of_twenty_lights_is_modelled_exactly_within_20_000_presses(seed):
    """All 24 dependencies and no other; of random presses as many show half of them at most."""
    config = get_preset("light-box").puzzle
    puzzle = config.make_puzzle(np.random.default_rng(0))
    assert len(puzzle.edges) == 24 and puzzle.success == 0.9
    agent = model_box(puzzle, 10_000, seed)
    assert agent.get_graph() == set(puzzle.edges)
    assert measure_forecasts(agent, puzzle) > 0.95
    blind = model_box(puzzle, 10_000, seed, is_random=True)
    assert len(blind.get_graph() & set(puzzle.edges)) <= 12


@pytest.mark.nightly
def test_an_experiment_is_no_worse_than_any_that_an_option_leads_to_and_is_on_its_way():
    """Compared with every action here and in the states in which the option of each light ends, all presses sure."""
    puzzle = LightBoxPuzzle(8, SMALL_BOX.edges, 7, 1.0)
    env = Presses(puzzle)
    agent = make_agent("vigorito-barto", env.observation_space, env.action_space, 0)
    learn(agent, env, 900)
    learner, legal = agent.model.learner, np.ones(8, np.bool_)
    observation, _ = env.reset()
    plan = agent.find_experiment(observation, legal)
    worth = [agent.gamma * learner.compute_gains(np.zeros((1, 8), np.bool_)).max()]
    assert len(agent.find_skills()) >= 6, "some stand on others"
    for bit in agent.find_skills():
        state, steps = 0, 1
        while (action := agent.choose_towards(bit, state)) is not None:
            state, steps = puzzle.update(state, Contacts((action,), 0.0)), steps + 1
        bits = np.array(puzzle.observe(state), np.bool_)
        worth.append(agent.gamma**steps * learner.compute_gains(bits[None]).max())
    assert plan.value >= max(worth) - 1e-9 and plan.value > worth[0]
    for state, action in zip(plan.states, plan.actions, strict=True):
        assert agent.model.pack(observation) == state
        gain = learner.compute_gains(np.asarray(observation, np.bool_)[None])[0, action]
        observation, *_ = env.step(action)
    assert plan.value == pytest.approx(agent.gamma ** len(plan.actions) * gain)


def test_without_trees_for_what_is_no_bit_it_learns_sets():
    for space in (spaces.MultiDiscrete([2, 3]), spaces.Discrete(5)):
        assert isinstance(make_agent("vigorito-barto", space, spaces.Discrete(2), 0).model.learner, GrowingSets)


@pytest.mark.nightly_for("trees-300")
@pytest.mark.parametrize(("models", "decisions"), [("trees", 300), ("sets", 150)])
def test_an_option_turns_its_bit_on_and_what_that_needs_before(models, decisions):
    env = make_button_env("chain", 4, "ignore", 0)
    agent = make_agent("vigorito-barto", env.observation_space, env.action_space, 0, models=models)
    assert [option.name for option in agent.get_options()] == ["policy"], "nothing is known yet"
    learn(agent, env, decisions)
    options = agent.get_options()
    assert [option.name for option in options] == [f"bit-{bit}" for bit in range(2, 6)]
    rng, lengths = np.random.default_rng(0), []
    for option in options:
        bit = int(option.name.removeprefix("bit-"))
        observation, info = env.reset()
        assert option.can_start(observation, info["action_mask"])
        run, length = option.begin(), 0
        while length == 0 or run.compute_termination(observation, info["action_mask"]) == 0:
            observation, *_, info = env.step(run.act(observation, info["action_mask"], rng))
            length += 1
        assert observation[bit] == 1
        assert not option.can_start(observation, np.ones(5, np.bool_))
        lengths.append(length)
    assert sorted(lengths) == [1, 2, 3, 4], "the last of the chain by way of all the others"


def test_an_option_cannot_start_where_no_way_to_what_it_needs_is_known():
    env = make_button_env("chain", 4, "ignore", 0)
    agent = make_agent("vigorito-barto", env.observation_space, env.action_space, 0)
    learn(agent, env, 300)
    skills = agent.find_skills()
    (deepest,) = [bit for bit in skills if not any(bit in dict(each.needs) for each in skills.values())]
    (needed, _), *_ = skills[deepest].needs
    assert agent.choose_towards(deepest, 0) is not None
    del skills[needed]
    assert agent.choose_towards(deepest, 0) is None


@pytest.mark.nightly
def test_what_was_learned_goes_on_from_a_checkpoint_to_the_bit():
    env = Presses(SMALL_BOX)
    agent, other = (make_agent("vigorito-barto", env.observation_space, env.action_space, 0) for _ in range(2))
    steps = list(itertools.islice(interact(agent, env, 300), 300))
    other.load_state_dict(agent.state_dict())
    observation, legal = steps[-1].next_observation, np.ones(8, np.bool_)
    assert agent.find_experiment(observation, legal) == other.find_experiment(observation, legal)
    assert agent.get_graph() == other.get_graph() and agent.find_skills() == other.find_skills()
