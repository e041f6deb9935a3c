"""Blocks World: states and transitions of PDDL's domain, optimal plans, problems that are read, and carrying."""

from __future__ import annotations

import dataclasses
from collections import Counter, deque

import gymnasium
import numpy as np
import pytest
import torch

import hrl_escape
from benchmarks.conformance import compare
from hrl_escape.checks import check_puzzle
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.maps import save_map
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels, Place
from hrl_escape.env.puzzles.blocks_world import (
    IN_HAND,
    BlocksWorldConfig,
    BlocksWorldPuzzle,
    find_fewest_moves,
    sample_towers,
)
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError
from hrl_escape.options import OptionsEnv
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.planning import RoomPlanner
from hrl_escape.planning.goals import GripGoal
from tests.env.isomorphism import check_isomorphism

assert hrl_escape  # registers the environments


class Stacks:
    """PDDL's domain by its four operators over sets of facts, goal reached at none of them.

    Action i < n grips in the tower whose lowest block is i, action n + i releases there.
    """

    def __init__(self, puzzle: BlocksWorldPuzzle) -> None:
        self.puzzle, self.count = puzzle, len(puzzle.names)

    def apply(self, facts: frozenset, name: str, block: int, other: int | None = None) -> frozenset | None:
        """The facts after an operator, as IPC-2000's domain file has it; None where it is not applicable."""
        clear, table, on = ("clear", block), ("ontable", block), ("on", block, other)
        free, holding, under = ("handempty",), ("holding", block), ("clear", other)
        needs, adds = {
            "pick-up": ({clear, table, free}, {holding}),
            "put-down": ({holding}, {clear, table, free}),
            "stack": ({holding, under}, {free, on, clear}),
            "unstack": ({on, clear, free}, {holding, under}),
        }[name]
        return facts - needs | adds if needs <= facts else None

    def list_next(self, facts: frozenset) -> list[frozenset]:
        """All facts that one operator leads to."""
        found = []
        for block in range(self.count):
            found += [self.apply(facts, name, block) for name in ("pick-up", "put-down")]
            found += [self.apply(facts, name, block, other) for name in ("stack", "unstack")
                      for other in range(self.count) if other != block]
        return [after for after in found if after is not None]

    def start(self) -> frozenset:
        """All blocks on the table."""
        return frozenset({("handempty",), *((word, b) for word in ("ontable", "clear") for b in range(self.count))})

    def list_states(self):
        """All states, breadth first."""
        known, queue = {self.start()}, [self.start()]
        for facts in queue:
            for after in self.list_next(facts):
                if after not in known:
                    known.add(after)
                    queue.append(after)
        return queue

    def step(self, facts, action, uniform=0.0):
        """The only operator that moves a block of, or onto, one tower."""
        release, base = divmod(action, self.count)
        on = {fact[1]: fact[2] for fact in facts if fact[0] == "on"}
        above = {below: block for block, below in on.items()}
        held = next((fact[1] for fact in facts if fact[0] == "holding"), None)
        if ("ontable", base) not in facts:
            return (self.apply(facts, "put-down", base) if release else None) or facts
        top = base
        while top in above:
            top = above[top]
        if release:
            return facts if held is None else self.apply(facts, "stack", held, top) or facts
        taken = self.apply(facts, "pick-up", top) if top == base else self.apply(facts, "unstack", top, on[top])
        return taken or facts

    def is_over(self, facts):
        on = {fact[1]: fact[2] for fact in facts if fact[0] == "on"}
        on |= {fact[1]: fact[1] for fact in facts if fact[0] == "ontable"}
        return all(on.get(block) == below for block, below in self.puzzle.goal)

    def encode(self, facts):
        below = {fact[1]: fact[2] for fact in facts if fact[0] == "on"}
        below |= {fact[1]: fact[1] for fact in facts if fact[0] == "ontable"}
        return self.puzzle.encode(tuple(below.get(block, IN_HAND) for block in range(self.count)))

    def count_fewest(self) -> int:
        """Fewest operators from the puzzle's start to its goal, breadth first."""
        start = next(facts for facts in self.list_states() if self.encode(facts) == self.puzzle.make_state())
        queue, known = deque([(start, 0)]), {start}
        while queue:
            facts, count = queue.popleft()
            if self.is_over(facts):
                return count
            for after in set(self.list_next(facts)) - known:
                known.add(after)
                queue.append((after, count + 1))
        raise AssertionError("no way")


def make_puzzle(count: int, seed: int = 0) -> BlocksWorldPuzzle:
    return BlocksWorldConfig(count).make_puzzle(np.random.default_rng(seed))


# --- the domain ----------------------------------------------------------------------------


@pytest.mark.nightly_for("4-73")
@pytest.mark.parametrize(("count", "towers"), [(2, 3), (3, 13), (4, 73), (5, 501)])  # OEIS A000262
def test_there_are_as_many_states_as_the_domain_has(count, towers):
    domain = Stacks(make_puzzle(count))
    states = domain.list_states()
    assert sum(("handempty",) in facts for facts in states) == towers
    assert len({domain.encode(facts) for facts in states}) == len(states)
    assert all(domain.puzzle.is_state(domain.encode(facts)) for facts in states)


def test_numbers_that_are_no_towers_are_no_states():
    puzzle = make_puzzle(3)
    states = {Stacks(puzzle).encode(facts) for facts in Stacks(puzzle).list_states()}
    assert {word for word in range(1 << 12) if puzzle.is_state(word)} == states


@pytest.mark.parametrize("hand", [False, True])
def test_options_do_what_the_operators_of_the_domain_do_from_any_pose(hand):
    room = generate(get_preset("blocks-world", count=3, hand=hand), 1)
    env = gymnasium.make("hrl_escape/BlocksWorld-v1", instance=room)
    domain = Stacks(env.unwrapped.instance.puzzle)
    goals = [f"{action}-place-{name}" for action in ("grip", "release") for name in "abc"]
    assert check_isomorphism(env, domain, goals=goals, pairs=30 if hand else 132) == (30 if hand else 132)


def test_facts_are_those_of_pddl_and_where_towers_stand():
    puzzle = make_puzzle(4)
    domain = Stacks(puzzle)
    for facts in domain.list_states():
        words = {f"{head}({','.join(puzzle.names[block] for block in blocks)})" if blocks else head
                 for head, *blocks in facts}
        seen = puzzle.get_facts(domain.encode(facts))
        assert {fact for fact in seen if not fact.startswith("at(")} == words
        assert sum(fact.startswith("at(") for fact in seen) == 3 + (("handempty",) in facts)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_the_rules_keep_the_contract(count):
    check_puzzle(make_puzzle(count), steps=60)


def test_start_and_goal_are_drawn_each_with_the_same_probability():
    rng = np.random.default_rng(0)
    counts = Counter(sample_towers(3, rng) for _ in range(13 * 200))
    assert len(counts) == 13
    assert sum((n - 200) ** 2 / 200 for n in counts.values()) < 32.9  # chi-square, 12 degrees of freedom, p = 0.001


# --- problems and plans --------------------------------------------------------------------

IPC = {  # IPC-2000, track 1: problem, and the optimal plan length that is published for it
    "4-0": ("(:INIT (CLEAR C) (CLEAR A) (CLEAR B) (CLEAR D) (ONTABLE C) (ONTABLE A) (ONTABLE B) (ONTABLE D)"
            "(HANDEMPTY)) (:goal (and (on d c) (on c b) (on b a)))", "d b a c", 6),
    "4-1": ("(:INIT (CLEAR B) (ONTABLE D) (ON B C) (ON C A) (ON A D) (HANDEMPTY))"
            "(:goal (AND (ON D C) (ON C A) (ON A B)))", "a c d b", 10),
    "5-0": ("(:INIT (CLEAR D) (CLEAR C) (ONTABLE D) (ONTABLE A) (ON C E) (ON E B) (ON B A) (HANDEMPTY))"
            "(:goal (AND (ON A E) (ON E B) (ON B D) (ON D C)))", "b e a c d", 12),
}


def write_problem(name: str, typed: str = " - block") -> str:
    body, blocks, _ = IPC[name]
    return f"(define (problem BLOCKS-{name}) ; IPC\n(:domain BLOCKS)\n(:objects {blocks}{typed}) {body})"


@pytest.mark.nightly_for("5-0")
@pytest.mark.parametrize("name", IPC)
def test_problems_of_the_competition_are_solved_with_the_published_number_of_operators(name):
    room = generate(get_preset("blocks-world", problem=write_problem(name)), 0)
    plan = room.puzzle.plan(room.puzzle.make_state())
    assert len(plan) == IPC[name][2] == Stacks(room.puzzle).count_fewest()
    escape = RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0]))
    assert [part.name.split("-")[0] for part in escape.parts] == [*["grip", "release"] * (len(plan) // 2), "go"]


def test_typed_problems_of_pddlgym_are_read_too():
    text = write_problem("4-1", " - block robot - robot").replace("(HANDEMPTY)", "(handempty robot)")
    assert BlocksWorldConfig(problem=text).make_puzzle(np.random.default_rng(0)) == BlocksWorldConfig(
        problem=write_problem("4-1", "")).make_puzzle(np.random.default_rng(0))


def test_goals_may_say_little():
    text = ("(define (problem p) (:domain blocks) (:objects a b c) (:init (ontable a) (on b a) (on c b) (handempty))"
            "(:goal {}))")
    for goal, fewest in (("(clear a)", 3), ("(and (clear b) (handempty))", 2), ("(ontable b)", 4), ("(on b a)", 0)):
        puzzle = BlocksWorldConfig(problem=text.format(goal)).make_puzzle(np.random.default_rng(0))
        check_puzzle(puzzle, steps=20)
        assert len(puzzle.plan(puzzle.make_state())) == fewest, goal


@pytest.mark.parametrize(("text", "message"), [
    ("(define (problem p)", "parentheses"), ("(define (problem p) (:init))", ":goal"),
    ("(define (:objects a a) (:init) (:goal (on a a)))", "named once"),
    ("(define (:objects a b) (:init (ontable a) (handempty)) (:goal (on a b)))", "for each block"),
    ("(define (:objects a b) (:init (ontable a) (ontable b) (handempty)) (:goal (under a b)))", "a fact of"),
    ("(define (:objects a b) (:init (ontable a) (ontable b) (handempty)) (:goal (and (on a b) (on b a))))", "towers"),
])
def test_what_is_no_problem_is_refused_in_one_message(text, message):
    with pytest.raises(ConfigError, match=message):
        BlocksWorldConfig(problem=text).make_puzzle(np.random.default_rng(0))


@pytest.mark.nightly
def test_large_problems_are_solved_though_not_always_by_the_fewest_moves():
    puzzle = make_puzzle(12, 3)
    plan = puzzle.plan(puzzle.make_state())
    state = puzzle.make_state()
    for operator in plan:
        assert operator.is_applicable(puzzle.get_facts(state))
        state = puzzle.update(state, puzzle.make_contacts(operator))
    assert puzzle.is_solved(state) and len(plan) <= 4 * 12
    assert find_fewest_moves(puzzle.decode(state), puzzle.wanted) == ()


# --- in rooms ------------------------------------------------------------------------------


@pytest.mark.nightly_for("True")
@pytest.mark.parametrize("hand", [False, True])
def test_both_engines_agree_along_an_escape(hand):
    """Random play seldom builds a tower: the plan does."""
    room = generate(get_preset("blocks-world", hand=hand), 1)
    rules, batch = Kinematics(room), TensorRoom(Rooms(instance=room), autoreset="disabled")
    batch.reset(torch.tensor([0]))
    state, puzzles = batch.get_room_state(0), set()
    for primitive in RoomPlanner(room).solve(state).primitives:
        outcome, step = batch.step(torch.tensor([primitive])), rules.step(state, primitive)
        state = step.state
        assert batch.get_room_state(0) == state and bool(outcome.terminated) == step.terminated
        assert (outcome.info.buttons_on[0].numpy() == room.puzzle.get_lit(state.puzzle)).all()
        puzzles.add(state.puzzle)
    assert rules.has_escaped(state) and len(puzzles) > 2


@pytest.mark.nightly_for("2")
@pytest.mark.parametrize("count", [2, 5])
def test_both_engines_agree_where_places_are_in_reach_all_the_time(count):
    """Places along the walls of the smallest room, touched everywhere: each grip and release then tells."""
    wide = Panels(width=4.0, places=tuple(Place(2.4 * x, 2.4 * y, 90.0 * (x != 0)) for x, y in (
        (0, 1), (1, 0), (0, -1), (-1, 0), (0, 1))))
    config = get_preset("blocks-world", count=count)
    config = dataclasses.replace(config, room=dataclasses.replace(config.room, width=5, depth=5),
                                 puzzle=BlocksWorldConfig(count, places=wide))
    found = compare([generate(config, seed) for seed in range(2)], 1500, copies=50)
    assert not found.disagreements, found.disagreements[0]


def test_meta_actions_pick_and_place_and_are_masked_where_they_cannot():
    room = generate(get_preset("blocks-world"), 1)
    env = OptionsEnv(gymnasium.make("hrl_escape/BlocksWorld-v1", instance=room), include_primitives=False)
    goals = list_goals(room)
    _, info = env.reset(seed=0)
    towers = room.puzzle.decode(env.unwrapped.get_state().puzzle)
    can = {goal: bool(is_possible) for goal, is_possible in zip(goals, info["action_mask"], strict=False)}
    for block in range(4):
        assert can[GripGoal(block, "grip")] == (towers[block] == block) and not can[GripGoal(block, "release")]
    taken = next(block for block in range(4) if towers[block] == block)
    *_, info = env.step(goals.index(GripGoal(taken, "grip")))
    now = room.puzzle.decode(env.unwrapped.get_state().puzzle)
    can = {goal: bool(is_possible) for goal, is_possible in zip(goals, info["action_mask"], strict=False)}
    for block in range(4):
        assert can[GripGoal(block, "release")] == (now[block] in (block, IN_HAND)) and not can[GripGoal(block, "grip")]


def list_signs(puzzle, state):
    return [puzzle.get_sign(state, target) for target in range(len(puzzle.target_names))]


def test_maps_show_the_towers(tmp_path):
    puzzle = BlocksWorldPuzzle(("a", "b", "c"), (0, 0, 1), ((0, 2),))
    assert list_signs(puzzle, puzzle.make_state()) == ["a b c", "", ""]
    assert list_signs(puzzle, puzzle.encode((0, 1, IN_HAND))) == ["a", "b", ""]
    room = generate(get_preset("blocks-world"), 1)
    save_map(tmp_path / "map.svg", room)
    text = "".join((tmp_path / "map.svg").read_text().split())
    towers = list_signs(room.puzzle, room.puzzle.make_state())
    assert any(towers)
    for name, tower in zip(room.puzzle.target_names, towers, strict=True):
        assert (f"{name}:{tower.replace(' ', '')}" if tower else name) in text


def test_places_hang_apart_so_that_one_is_touched_at_a_time():
    for seed in range(10):
        room = generate(get_preset("blocks-world", count=6), seed)
        reach = room.compute_press_reach(room.targets[0])
        for number, target in enumerate(room.targets):
            for other in room.targets[:number]:
                assert np.hypot(target.x - other.x, target.y - other.y) > 2 * np.hypot(0.5, 0.05) + 2 * reach


@pytest.mark.nightly
def test_a_planner_escapes_from_every_room_of_a_sample():
    for seed in range(12):
        room = generate(get_preset("blocks-world", count=3 + seed % 3), seed)
        state = Kinematics(room).make_state(room.starts[0])
        plan = RoomPlanner(room).solve(state)
        assert Kinematics(room).has_escaped(plan.states[-1])
