"""The recipe game against rules told another way, and its fewest presses against a search of all stores."""

import heapq

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.batched.puzzles.base import TensorContacts, get_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.recipes import MATERIALS, NAMES, RECIPES, RecipesConfig, RecipesPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning import RoomPlanner


def play(store: dict, name: str) -> dict:
    """Crafter's rules, one `if` each."""
    new = dict(store)
    if name == "wood":
        new["wood"] += 1
    elif name in ("stone", "coal") and store["wood-pickaxe"]:
        new[name] += 1
    elif name == "iron" and store["stone-pickaxe"]:
        new["iron"] += 1
    elif name == "diamond" and store["iron-pickaxe"]:
        new["diamond"] += 1
    elif name == "table" and not store["table"] and store["wood"] >= 2:
        new |= {"table": 1, "wood": store["wood"] - 2}
    elif name == "furnace" and not store["furnace"] and store["table"] and store["stone"] >= 4:
        new |= {"furnace": 1, "stone": store["stone"] - 4}
    elif name == "wood-pickaxe" and not store[name] and store["table"] and store["wood"]:
        new |= {name: 1, "wood": store["wood"] - 1}
    elif name == "stone-pickaxe" and not store[name] and store["table"] and store["wood"] and store["stone"]:
        new |= {name: 1, "wood": store["wood"] - 1, "stone": store["stone"] - 1}
    elif (name == "iron-pickaxe" and not store[name] and store["table"] and store["furnace"] and store["wood"]
          and store["coal"] and store["iron"]):
        new |= {name: 1, "wood": store["wood"] - 1, "coal": store["coal"] - 1, "iron": store["iron"] - 1}
    return {key: min(value, 9) for key, value in new.items()}


@settings(max_examples=60)
@given(st.lists(st.sampled_from([*NAMES, "wood", "wood", "stone"]), max_size=120))
def test_presses_do_what_the_rules_say(presses):
    puzzle, state, store = RecipesPuzzle(), 0, dict.fromkeys(NAMES, 0)
    for name in presses:
        state, store = puzzle.update(state, Contacts((NAMES.index(name),))), play(store, name)
        assert {key: puzzle.count(state, key) for key in NAMES} == store
        assert puzzle.is_state(state) and puzzle.is_solved(state) == (store["diamond"] > 0)
        assert [puzzle.get_sign(state, n) for n in (0, 1)] == [str(store[key] or "") for key in ("wood", "stone")]
        assert puzzle.get_lit(state) == tuple(store[key] > 0 for key in NAMES)


def find_fewest(puzzle: RecipesPuzzle, begin: int) -> int:
    """Uniform-cost search over stores, none of which holds more of a material than all recipes together use."""
    most = {name: max(1, sum(dict(r.uses).get(name, 0) for r in RECIPES.values())) for name in NAMES[:MATERIALS]}
    seen, queue = {begin}, [(0, begin)]
    while queue:
        presses, state = heapq.heappop(queue)
        if puzzle.is_solved(state):
            return presses
        for target in range(len(NAMES)):
            after = puzzle.update(state, Contacts((target,)))
            if after not in seen and all(puzzle.count(after, name) <= max(most[name], puzzle.count(begin, name))
                                         for name in most):
                seen.add(after)
                heapq.heappush(queue, (presses + 1, after))
    raise AssertionError("the goal is always within reach")


@pytest.mark.parametrize(("goal", "fewest"), [("diamond", 18), ("wood", 1), ("stone", 6), ("furnace", 10), ("iron", 9)])
def test_the_plan_has_as_few_presses_as_the_search(goal, fewest):
    puzzle = RecipesPuzzle(goal)
    assert len(puzzle.plan(0)) == find_fewest(puzzle, 0) == fewest


def test_the_plan_is_shortest_and_works_from_wherever_play_leads():
    puzzle, rng = RecipesPuzzle(), np.random.default_rng(0)
    for _ in range(12):
        state = 0
        for target in rng.choice(len(NAMES), 60, p=[0.3, 0.2, 0.05, 0.05, 0, 0.1, 0.1, 0.1, 0.05, 0.05]).tolist():
            state = puzzle.update(state, Contacts((target,)))
        names = puzzle.list_presses(state)
        assert len(names) == find_fewest(puzzle, state)
        left = [puzzle.compute_progress(state)]
        for name in names:
            state = puzzle.update(state, Contacts((NAMES.index(name),)))
            left.append(puzzle.compute_progress(state))
        assert puzzle.is_solved(state) and left == sorted(set(left)) and left[-1] == 1.0


def test_the_symbolic_model_predicts_every_press():
    for goal in ("diamond", "furnace"):
        check_puzzle(RecipesConfig(goal).make_puzzle(np.random.default_rng(0)), steps=150)


def test_the_tensor_form_agrees_in_any_state_and_not_only_where_random_play_leads():
    puzzle, rng = RecipesPuzzle("iron-pickaxe"), np.random.default_rng(0)
    form = get_tensor_puzzle("recipes")
    counts = np.concatenate([rng.integers(0, 10, (MATERIALS, 4000)), rng.integers(0, 2, (MATERIALS, 4000))])
    shifts = np.array([0, 4, 8, 12, 16, 20, 21, 22, 23, 24])[:, None]
    words, pressed = (counts << shifts).sum(0), 1 << rng.integers(0, len(NAMES), 4000)
    tables = {"goal": torch.from_numpy(form.make_tables([puzzle], SpaceLayout(target_names=NAMES))["goal"])}
    bits, none = torch.from_numpy(pressed), torch.zeros(4000, dtype=torch.int64)
    at, before = none.double(), none - 1
    contacts = TensorContacts(bits, at, bits, none, none == 0, at, at, before, before)
    after = form.update(tables, torch.from_numpy(words), contacts, len(NAMES)).tolist()
    assert after == [puzzle.update(word, Contacts((press.bit_length() - 1,)))
                     for word, press in zip(words.tolist(), pressed.tolist(), strict=True)]
    assert form.is_solved(tables, torch.tensor(after)).tolist() == [puzzle.is_solved(word) for word in after]
    assert np.mean(np.array(after) != words) > 0.3


def test_the_planner_escapes_from_the_room_with_eighteen_presses():
    room = generate(get_preset("recipes"), 0)
    rules = Kinematics(room)
    state, presses = rules.make_state(room.starts[0]), 0
    for primitive in RoomPlanner(room, budget=3000).solve(state).primitives:
        step = rules.step(state, primitive)
        presses += step.state.puzzle != state.puzzle
        state = step.state
    assert rules.has_escaped(state) and presses == 18
