"""Growing sets by hand, the edges that matter, and options of bits that stand on each other."""

import math

import numpy as np
import pytest

from hrl_escape.agents.algorithms.structure.vigorito_barto import GrowingSets
from hrl_escape.agents.registry import make_agent
from tests.agents.puzzle_envs import learn_puzzle, make_button_env
from tests.agents.running import learn


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


@pytest.mark.parametrize(("kind", "rule"), [("tree", "ignore"), ("layered", "reset"), ("chain", "ignore")])
def test_it_finds_the_edges_that_matter_and_escapes(kind, rule):
    learned = learn_puzzle("vigorito-barto", make_button_env(kind, 5, rule, 1), 1_500, 1)
    assert (learned.precision, learned.recall) == (1.0, 1.0)
    assert learned.first_escape is not None


def test_an_option_turns_its_bit_on_and_what_that_needs_before():
    env = make_button_env("chain", 4, "ignore", 0)
    agent = make_agent("vigorito-barto", env.observation_space, env.action_space, 0)
    assert [option.name for option in agent.get_options()] == ["policy"], "nothing is known yet"
    learn(agent, env, 150)
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
        assert agent.choose_towards(bit, observation) is None
        assert not option.can_start(observation, np.ones(5, np.bool_))
        lengths.append(length)
    assert sorted(lengths) == [1, 2, 3, 4], "the last of the chain by way of all the others"
