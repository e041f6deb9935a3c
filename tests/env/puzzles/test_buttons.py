"""The button puzzle against two independent models: a brute-force interpreter, and order theory."""

import dataclasses
import itertools

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.buttons import FAILED, VIOLATION_RULES, ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.cues import CuesConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.planner import RoomPlanner


@st.composite
def dags(draw, most):
    """(number of nodes, edges of a random DAG in random order, not sorted by number)."""
    count = draw(st.integers(1, most))
    order = draw(st.permutations(range(count)))
    pairs = [(order[i], order[j]) for i in range(count) for j in range(i + 1, count)]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=30)) if pairs else []
    return count, tuple(edges)


def press_by_hand(lit, button, edges, on_violation, allow_off):
    """One press, straight from the rule's words, on a set of button numbers; None once the puzzle is failed."""
    if lit is None:
        return None
    if button in lit:
        return lit - {button} if allow_off else lit
    if all(parent in lit for parent, child in edges if child == button):
        return lit | {button}
    return {"ignore": lit, "reset": set(), "fail": None}[on_violation]


@given(dags(12), st.sampled_from(VIOLATION_RULES), st.booleans(), st.data())
def test_presses_do_what_the_rule_says_on_any_dag(dag, on_violation, allow_off, data):
    count, edges = dag
    goal = data.draw(st.integers(0, count - 1))
    puzzle = ButtonsPuzzle(count, edges, goal, on_violation, allow_off)
    state, lit = puzzle.make_state(), set()
    for pressed in data.draw(st.lists(st.sets(st.integers(0, count - 1), max_size=3), max_size=40)):
        state = puzzle.update(state, Contacts(tuple(sorted(pressed))))
        for button in sorted(pressed):
            lit = press_by_hand(lit, button, edges, on_violation, allow_off)
        assert puzzle.is_failed(state) == (lit is None) and puzzle.is_state(state)
        if lit is None:
            assert not puzzle.is_solved(state)
            break
        assert puzzle.get_lit(state) == tuple(i in lit for i in range(count))
        assert puzzle.observe(state) == tuple(float(i in lit) for i in range(count))
        assert puzzle.is_solved(state) == (goal in lit)


@pytest.mark.parametrize("on_violation", VIOLATION_RULES)
def test_a_button_comes_on_once_all_of_its_parents_are(on_violation):
    for first, second in ((0, 1), (1, 0)):
        puzzle = ButtonsPuzzle(3, ((0, 2), (1, 2)), 2, on_violation)
        one = puzzle.update(puzzle.make_state(), Contacts((first,)))
        assert puzzle.get_lit(one) == (first == 0, first == 1, False)
        assert not puzzle.is_solved(puzzle.update(one, Contacts((2,)))), "one parent is not enough"
        assert puzzle.is_solved(puzzle.update(puzzle.update(one, Contacts((second,))), Contacts((2,))))


@pytest.mark.parametrize("on_violation", VIOLATION_RULES)
def test_a_press_before_its_parent_does_what_the_rule_says(on_violation):
    puzzle = ButtonsPuzzle(4, ((0, 1), (1, 2), (2, 3)), 3, on_violation)
    state = puzzle.update(puzzle.update(puzzle.make_state(), Contacts((0,))), Contacts((1,)))
    after = puzzle.update(state, Contacts((3,)))
    assert puzzle.is_failed(after) == (on_violation == "fail")
    if on_violation != "fail":
        assert puzzle.get_lit(after) == ((False,) * 4 if on_violation == "reset" else (True, True, False, False))


@given(dags(7))
def test_reachable_sets_of_lit_buttons_are_the_down_sets_of_the_dag(dag):
    """Order theory: from all off, pressing reaches exactly the sets that hold the parents of each member."""
    count, edges = dag
    puzzle = ButtonsPuzzle(count, edges, 0)
    reached, new = {puzzle.make_state()}, {puzzle.make_state()}
    while new:
        new = {puzzle.update(state, Contacts((i,))) for state in new for i in range(count)} - reached
        reached |= new
    down_sets = {
        sum(1 << i for i in chosen)
        for size in range(count + 1) for chosen in map(set, itertools.combinations(range(count), size))
        if all(parent in chosen for parent, child in edges if child in chosen)
    }
    assert reached == down_sets


def test_the_default_goal_comes_last_in_topological_order():
    for seed in range(20):
        puzzle = ButtonsConfig(count=6).make_puzzle(np.random.default_rng(seed))
        assert puzzle.goal not in {parent for parent, _ in puzzle.edges}


# --- dead ends -----------------------------------------------------------------------------------

LOCKED = ButtonsConfig(count=6, graph=GraphConfig(kind="layered", max_parents=2), dead_ends=4)


def press_one(lit, button, edges, locks):
    """One press, straight from the rule's words."""
    ready = all(parent in lit for parent, child in edges if child == button)
    return lit | {button} if ready and not any(b == button and a in lit for a, b in locks) else lit


def explore(puzzle):
    """{set of buttons that can be lit: sets one press later}, by the rule's words."""
    after, queue = {}, [frozenset()]
    for lit in queue:
        after[lit] = {press_one(lit, i, puzzle.edges, puzzle.locks) for i in range(puzzle.count)}
        queue += [then for then in after[lit] if then not in after and then not in queue]
    return after


def test_dead_ends_can_be_walked_into_and_avoided():
    """From the first state there is a way, of as many presses as the goal needs buttons; from some states none."""
    lost_by_number = 0
    for seed in range(40):
        puzzle = LOCKED.make_puzzle(np.random.default_rng(seed))
        assert len(puzzle.locks) == 4
        after = explore(puzzle)
        solvable = {lit for lit in after if puzzle.goal in lit}
        while grown := {lit for lit in after if after[lit] & solvable} - solvable:
            solvable |= grown
        assert frozenset() in solvable and len(solvable) < len(after), "there is a way, and there is a trap"
        model = puzzle.make_symbolic_model()
        for lit in after:
            state = sum(1 << i for i in lit)
            assert {puzzle.update(state, Contacts((i,))) for i in range(6)} == {sum(1 << i for i in then)
                                                                             for then in after[lit]}
            found = model.find_fewest(puzzle.get_facts(state))
            assert (found is not None) == (lit in solvable)
        needed = {puzzle.goal}
        while more := {parent for parent, child in puzzle.edges if child in needed} - needed:
            needed |= more
        fewest = model.find_fewest(puzzle.get_facts(0))
        assert fewest is not None and len(fewest) == len(needed)
        lit = frozenset()
        for button in 6 * list(range(6)):
            lit = press_one(lit, button, puzzle.edges, puzzle.locks)
        lost_by_number += puzzle.goal not in lit
    assert lost_by_number >= 32, "pressing by number is caught nearly always"


def test_dead_ends_need_buttons_that_stay_on_and_a_choice_of_order():
    with pytest.raises(ConfigError, match="turned off again"):
        ButtonsConfig(count=4, dead_ends=1, allow_off=True)
    with pytest.raises(ConfigError, match="neither needs the other"):
        ButtonsConfig(count=4, dead_ends=1).make_puzzle(np.random.default_rng(0))  # a chain
    with pytest.raises(ConfigError, match="cycles"):
        ButtonsPuzzle(3, ((0, 2), (1, 2)), 2, locks=((0, 1), (1, 0)))


# --- what a mistake does ---------------------------------------------------------------------


def test_a_failed_puzzle_takes_no_further_press_and_keeps_its_lights():
    puzzle = ButtonsPuzzle(3, ((0, 1), (1, 2)), 2, "fail")
    failed = puzzle.update(0b001, Contacts((2,)))
    assert failed == 0b001 | FAILED and puzzle.is_failed(failed) and not puzzle.is_failed(0b001)
    assert puzzle.update(failed, Contacts((1,))) == failed
    assert puzzle.update(0b001, Contacts((1, 2))) == 0b111  # in index order, both are allowed
    assert ButtonsPuzzle(3, ((2, 0),), 1, "fail").update(0, Contacts((0, 1))) == FAILED  # the goal comes too late
    late = ButtonsPuzzle(3, ((0, 2),), 1, "fail").update(0, Contacts((1, 2)))
    assert late == 0b010 | FAILED and not ButtonsPuzzle(3, ((0, 2),), 1, "fail").is_solved(late)
    assert puzzle.symbolic.has_dead_ends
    assert not puzzle.is_state(FAILED << 1) and not puzzle.is_state(FAILED | 0b1000) and not puzzle.is_state(-1)
    assert not ButtonsPuzzle(3, (), 2).is_state(FAILED)


@pytest.mark.nightly
def test_rooms_draw_what_a_mistake_does_and_nothing_else_depends_on_it():
    marks = CuesConfig("rank", levels=5, truth=0.5)
    config = ButtonsConfig(count=5, graph=GraphConfig(kind="layered", max_parents=2), cues=marks)
    drawn = dataclasses.replace(config, on_violation="drawn")
    rules = []
    for seed in range(600):
        plain, made = (each.make_puzzle(np.random.default_rng(seed)) for each in (config, drawn))
        rules.append(made.on_violation)
        assert dataclasses.replace(made, on_violation="ignore") == plain
    assert all(abs(rules.count(rule) / 600 - 1 / 3) < 0.06 for rule in VIOLATION_RULES)  # three standard errors


@pytest.mark.parametrize(("fields", "words"), [
    ({"count": 64}, "puzzle.count = 64 is not possible: at most 63"),
    ({"count": 5, "dead_ends": 1}, "puzzle.dead_ends"), ({"count": 3, "doors": 1}, "puzzle.doors")])
def test_rules_that_cannot_be_are_refused(fields, words):
    with pytest.raises(ConfigError, match=words):
        ButtonsConfig(**fields, on_violation="drawn")
    with pytest.raises(ConfigError, match="at most 63"):
        ButtonsPuzzle(64, on_violation="fail")


@pytest.mark.parametrize("engine", ["single", "many"])
def test_a_wrong_press_ends_the_episode_without_an_escape(engine):
    config = RoomConfig(puzzle=ButtonsConfig(count=2, graph=GraphConfig(relabel=False), on_violation="fail"))
    room = generate(config, 3)
    plan = RoomPlanner(room).plan(RoomPlanner(room).rules.make_state(room.starts[0]), "press-button-2").primitives
    if engine == "single":
        env = EscapeRoomEnv(instance=room)
        env.reset(seed=0)
        *_, last = [env.step(action) for action in plan]
        assert env.instance.puzzle.is_failed(env.get_state().puzzle)
    else:
        env = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, instance=room)
        env.reset(seed=0)
        *_, last = [env.step(np.full(2, action)) for action in plan]
        last = tuple(np.asarray(part).flat[0] for part in last[:4])
    assert last[1:4] == (-1.0, True, False)


@pytest.mark.parametrize("observation", ["objects", "features", "state", "egocentric"])
def test_nothing_shows_before_the_first_mistake_what_one_does(observation):
    """Who sees, is told and may do the same under all three rules cannot know which holds."""
    config = RoomConfig(puzzle=ButtonsConfig(count=3, on_violation="drawn", cues=CuesConfig("rank", levels=3)))
    room, seen = generate(config, 5), []
    first = [button for button in range(3) if not room.puzzle.parent_masks[button]][0]
    for rule in VIOLATION_RULES:
        made = dataclasses.replace(room, puzzle=dataclasses.replace(room.puzzle, on_violation=rule))
        env = OptionsEnv(EscapeRoomEnv(instance=made, observation=observation))
        begun, mask = env.reset(seed=0), env.action_masks()
        pressed = env.step(env.action_names.index(f"press-button-{first + 1}"))
        told = [{name: value for name, value in info.items() if name != "instance"} for info in (begun[1], pressed[4])]
        seen.append((begun[0].tolist(), mask.tolist(), pressed[0].tolist(), pressed[1:4], str(told)))
        late = next(button for button in range(3) if room.puzzle.parent_masks[button] & ~(1 << first))
        mistaken = env.step(env.action_names.index(f"press-button-{late + 1}"))
        assert mistaken[2] == (rule == "fail")
    assert seen[0] == seen[1] == seen[2]
