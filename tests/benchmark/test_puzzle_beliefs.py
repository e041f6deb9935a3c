"""Beliefs over puzzles: costs equal plain recursions and hand counts, and play costs what was foretold."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from hrl_escape.agents.spec import BAYES, SEARCH_BACKTRACK, AgentSpec
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.bayes import PuzzlePosterior
from hrl_escape.benchmark.references.path_lengths import PathLengths
from hrl_escape.benchmark.references.puzzle_beliefs import OPEN, PuzzleBeliefs, find_solved, list_drawn
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.puzzles.base import PuzzleConfig
from hrl_escape.env.puzzles.codes import CodeLockConfig, CodeLockPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.light_box import LightBoxConfig
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet

LADDER = load_benchmark("ladder-2")


def make_box(count: int, success: float) -> LightBoxConfig:
    return LightBoxConfig(count=count, graph=GraphConfig(kind="chain"), success=success)


def count_presses(config: PuzzleConfig) -> float:
    """Fewest expected presses, one primitive each."""
    beliefs = PuzzleBeliefs(list_drawn(config))
    count = beliefs.chances.shape[1]
    return float(beliefs.solve(PathLengths(np.ones((1, count)), np.zeros((1, count), int), np.zeros(1)))[0, 0])


# --- expected presses ------------------------------------------------------------------------


def test_every_puzzle_is_listed_with_its_probability():
    codes = list_drawn(CodeLockConfig(digits=3, length=3))
    assert len(codes) == 3 * 2 * 2 and set(codes.values()) == {1 / 12}
    boxes = list_drawn(make_box(3, 0.5))
    assert len(boxes) == 6 and sum(boxes.values()) == pytest.approx(1)
    drawn = {make_box(3, 0.5).make_puzzle(np.random.default_rng(seed)) for seed in range(60)}
    assert drawn == boxes.keys()


@pytest.mark.parametrize(("digits", "length", "shown"), [(2, 3, True), (3, 2, True), (3, 3, True), (4, 2, True),
                                                         (2, 3, False), (3, 2, False)])
@pytest.mark.parametrize("memory", ["reset", "slide"])
def test_a_lock_costs_what_a_plain_recursion_over_codes_finds(digits: int, length: int, shown: bool, memory: str):
    config = CodeLockConfig(digits=digits, length=length, memory=memory, shown=shown)  # pyright: ignore

    def press(code: tuple[int, ...], entered: int, digit: int) -> int:
        if code[entered] == digit:
            return entered + 1
        if memory == "reset":
            return 0
        latest = (*code[:entered], digit)
        return max(n for n in range(entered + 1) if code[:n] == latest[len(latest) - n:])

    @cache
    def need(locks: frozenset[tuple[tuple[int, ...], int]], budget: int) -> float:
        """Expected presses; a press more than the budget allows is never needed."""
        if budget == 0:
            return 1e6
        best = 1e6
        for digit in range(digits):
            parts: dict[int, list[tuple[tuple[int, ...], int]]] = {}
            for code, entered in locks:
                after = press(code, entered, digit)
                parts.setdefault(after if shown or after == length else -1, []).append((code, after))
            if len(parts) == 1 and frozenset(*parts.values()) == locks:
                continue
            best = min(best, 1 + sum(len(part) / len(locks) * need(frozenset(part), budget - 1)
                                     for seen, part in parts.items() if seen != length))
        return best

    codes = frozenset((puzzle.code, 0) for puzzle in list_drawn(config) if isinstance(puzzle, CodeLockPuzzle))
    assert count_presses(config) == pytest.approx(need(codes, 16), abs=0.02)


@pytest.mark.parametrize("length", [1, 3, 7, 8])
def test_two_digits_in_turn_need_half_a_press_more_than_the_code(length: int):
    """Two codes alternate; who begins with the wrong digit has entered the rest of the other code one press later."""
    assert count_presses(CodeLockConfig(digits=2, length=length, shown=False)) == length + 0.5


@pytest.mark.parametrize("success", [0.9, 0.5])
def test_a_box_of_two_lights_costs_what_a_plain_recursion_finds(success: float):
    @cache
    def need(failed: tuple[int, int], budget: int) -> float:
        """Presses in the dark after so many failures of each light; then the other light, until it comes on."""
        if budget == 0:
            return 0.0
        odds = [(1 - success) ** number for number in failed]
        found = []
        for light in range(2):
            root = odds[light] / sum(odds)
            later = failed[0] + (light == 0), failed[1] + (light == 1)
            found.append(1 + root + (1 - root * success) * need(later, budget - 1))  # the other takes 1 / success
        return min(found)

    assert count_presses(make_box(2, success)) == pytest.approx(need((0, 0), 40), abs=0.02)


def test_without_noise_two_lights_need_two_presses_and_half():
    assert count_presses(make_box(2, 1.0)) == pytest.approx(2.5)


@pytest.mark.parametrize("config", [make_box(3, 0.5), CodeLockConfig(digits=3, length=3)], ids=["box", "lock"])
def test_presses_of_the_best_policy_come_to_what_was_foretold(config: PuzzleConfig):
    beliefs = PuzzleBeliefs(list_drawn(config))
    count = beliefs.chances.shape[1]
    costs = beliefs.solve(PathLengths(np.ones((1, count)), np.zeros((1, count), int), np.zeros(1)))
    best = np.argmin([beliefs.compute_costs_after(costs, np.arange(len(beliefs)), target)[:, 0]
                      for target in range(count)], axis=0)
    rng, presses = np.random.default_rng(0), 0
    for _ in range(3000):
        number = 0
        while number != OPEN:
            draw = np.searchsorted(beliefs.chances[number, best[number]].cumsum(), rng.random())
            number = int(beliefs.after[number, best[number], draw])
            presses += 1
    assert presses / 3000 == pytest.approx(float(costs[0, 0]), rel=0.05)


def test_more_beliefs_than_fit_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hrl_escape.benchmark.references.puzzle_beliefs.MOST_PUZZLE_BELIEFS", 10)
    with pytest.raises(UnsupportedError, match="more than 10 beliefs"):
        PuzzleBeliefs(list_drawn(CodeLockConfig(digits=3, length=3)))


# --- rooms -----------------------------------------------------------------------------------


def play(name: str, rooms: InstanceSet) -> np.ndarray:
    env, recorder = make_agent_env(AgentSpec(name), rooms, "features", {})
    found = evaluate(make_reference(name, env, recorder), env, len(rooms))
    env.close()
    assert all(found.successes)
    return np.array(found.lengths)


@pytest.mark.nightly_for("codes-2", "noise-2")
@pytest.mark.parametrize("rung", ["memory-2", "codes-2", "noise-2"])
def test_the_planner_knows_how_rooms_are_drawn_and_needs_fewer_primitives_than_search(rung: str):
    rooms = LADDER[rung].test[:8]
    assert play(BAYES, rooms).mean() < play(SEARCH_BACKTRACK, rooms).mean()


@pytest.mark.nightly
def test_over_all_codes_of_a_room_the_planner_needs_what_was_foretold():
    rung = LADDER["codes-2"]
    room, lengths = rung.test[0], []
    posterior, count = PuzzlePosterior(room, rung.config), len(room.targets)
    names = room.puzzle.target_names
    for puzzle in list_drawn(rung.config.puzzle):
        posterior.forget()
        planner, primitives = RoomPlanner(dataclasses.replace(room, puzzle=puzzle)), 0.0
        state = planner.rules.make_state(room.starts[0])
        while not puzzle.is_solved(state.puzzle):
            target = posterior.choose(state, range(count))
            plan = planner.plan(state, f"press-{names[target]}")
            primitives, state = primitives + plan.cost, plan.states[-1]
            posterior.learn(target, state.puzzle)
        lengths.append(primitives + planner.plan(state, "go-to-exit").cost)
    planner = RoomPlanner(room)
    start = planner.rules.make_state(room.starts[0])._replace(puzzle=find_solved(room.puzzle))
    foretold = min(planner.plan(start, f"press-{name}").cost + posterior.beliefs.compute_costs_after(
        posterior.costs, np.array([0]), target)[0, count * count + target] for target, name in enumerate(names))
    assert np.mean(lengths) == pytest.approx(foretold, rel=0.04)


def test_who_knows_the_rules_of_lights_out_has_nothing_to_find_out():
    """Presses follow from the numbers of the lights, and the goal is shown."""
    rooms = LADDER["undoing-1"].test[:1]
    env, recorder = make_agent_env(AgentSpec(BAYES), rooms, "features", {})
    with pytest.raises(UnsupportedError, match="nothing is hidden in lights-out: use oracle"):
        evaluate(make_reference(BAYES, env, recorder), env, 1)
    env.close()
