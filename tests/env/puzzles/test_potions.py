"""Potions: hidden rules, trials, and what remembering is worth, exactly."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hrl_escape
from hrl_escape.checks import check_puzzle
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.potions import Brew, PotionsPuzzle, list_rules
from hrl_escape.errors import ContractError
from hrl_escape.planning.planner import RoomPlanner
from tests.env.isomorphism import check_isomorphism

assert hrl_escape  # registers the environments


class Stones:
    """Stones as tuples of booleans; `effects` says of each potion which feature it turns, and which way."""

    def __init__(self, puzzle, rules):
        self.puzzle, self.rules = puzzle, rules

    def list_states(self):
        stones = [(False, False), (True, False), (False, True)]
        return [(stone, done, rule) for rule in self.rules for done in range(self.puzzle.trials) for stone in stones]

    def step(self, state, action):
        stone, done, rule = list(state[0]), state[1], state[2]
        feature, is_on = list_rules(2)[rule][action]
        stone[feature] = is_on
        return ((False, False), done + 1, rule) if all(stone) else (tuple(stone), done, rule)

    def is_over(self, state):
        return state[1] == self.puzzle.trials

    def encode(self, state):
        stone, done, rule = state
        return self.puzzle.encode(Brew(stone[0] + 2 * stone[1], done, rule))


class Forgetful(Stones):
    def step(self, state, action):
        stone, done, rule = super().step(state, action)
        return stone, done, rule if done == state[1] else (rule + 1) % 24


def test_potions_are_stones_whose_rule_stays_through_all_trials():
    env = gymnasium.make("hrl_escape/Potions-v1")
    puzzle = env.unwrapped.instance.puzzle
    rules = (0, 7, 23)
    assert check_isomorphism(env, Stones(puzzle, rules), pairs=60) == 60
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(env, Forgetful(puzzle, rules), pairs=90)


def test_every_episode_draws_a_rule_that_is_not_observed():
    env = gymnasium.make("hrl_escape/Potions-v1")
    puzzle = env.unwrapped.instance.puzzle
    seen, rules = set(), set()
    for seed in range(60):
        seen.add(env.reset(seed=seed)[0][-3:].tobytes())
        rules.add(puzzle.decode(env.unwrapped.get_state().puzzle).rule)
    assert len(rules) > 15 and len(seen) == 1
    assert len(list_rules(2)) == 24 and len(list_rules(3)) == 720


@given(st.integers(1, 3), st.integers(1, 3), st.integers(0, 719), st.lists(st.integers(0, 5), max_size=40))
def test_presses_do_what_the_rule_says(features, trials, rule, presses):
    puzzle, number = PotionsPuzzle(features, trials), rule % len(list_rules(features))
    state, on, done = puzzle.encode(Brew(0, 0, number)), set(), 0
    for potion in (press % (2 * features) for press in presses):
        state = puzzle.update(state, Contacts((potion,)))
        feature, is_on = list_rules(features)[number][potion]
        if done < trials:
            on = on | {feature} if is_on else on - {feature}
            on, done = (set(), done + 1) if len(on) == features else (on, done)
        assert puzzle.decode(state) == (sum(1 << i for i in on), done, number) and puzzle.is_state(state)
        assert puzzle.is_solved(state) == (done == trials)


def compute_expected(features: int, trials: int) -> float:
    """Fewest presses on average of who is not told the rule: value iteration over what is seen and still possible."""
    puzzle = PotionsPuzzle(features, trials)
    begin = (0, 0, frozenset(range(len(list_rules(features)))))
    nodes, queue = {begin: []}, [begin]
    for node in queue:
        stone, done, possible = node
        if done == trials:
            continue
        for potion in range(2 * features):
            groups = {}
            for rule in possible:
                after = puzzle.decode(puzzle.update(puzzle.encode(Brew(stone, done, rule)), Contacts((potion,))))
                groups.setdefault(after[:2], set()).add(rule)
            outcomes = [(len(group) / len(possible), (*seen, frozenset(group))) for seen, group in groups.items()]
            nodes[node].append(outcomes)
            for _, then in outcomes:
                if then not in nodes:
                    nodes[then] = []
                    queue.append(then)
    price, last = dict.fromkeys(nodes, 0.0), 1.0
    while abs(price[begin] - last) > 1e-12:
        last = price[begin]
        for node in reversed(queue):
            if nodes[node]:
                price[node] = 1 + min(sum(odds * price[then] for odds, then in outcomes) for outcomes in nodes[node])
    return price[begin]


@pytest.mark.nightly
def test_what_is_learned_in_the_first_trial_helps_in_the_others():
    assert compute_expected(1, 1) == pytest.approx(3 / 2), "one of two potions"
    assert compute_expected(1, 3) == pytest.approx(3 / 2 + 2)
    assert compute_expected(2, 1) == pytest.approx(11 / 3), "two for who is told"
    assert compute_expected(2, 5) == pytest.approx(11 / 3 + 4 * 2), "from the second trial on one press a feature"


@pytest.mark.nightly
def test_the_planner_knows_the_rule_and_makes_each_stone_in_one_press_a_feature():
    room = gymnasium.make("hrl_escape/Potions-v1").unwrapped
    planner = RoomPlanner(room.instance)
    for seed in range(3):
        room.reset(seed=seed)
        plan = planner.solve(room.get_state())
        assert len([part for part in plan.parts if part.name != "go-to-exit"]) == 2 * 5
        assert plan.execute(room).escaped


def test_potions_keep_the_contract():
    for features, trials in ((1, 1), (2, 3), (3, 1)):
        check_puzzle(PotionsPuzzle(features, trials), steps=60)
    puzzle = get_preset("potions").puzzle.make_puzzle(np.random.default_rng(0))
    assert PotionsPuzzle.from_dict(puzzle.to_dict()) == puzzle
    assert not puzzle.is_state(0b11) and not puzzle.is_state(24 << 8) and puzzle.is_state(23 << 8)
