"""Errors of decisions are those of a plain recursion, and sum to the regret with luck that averages to zero."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.action_errors import ActionErrors, estimate_errors
from hrl_escape.benchmark.references.decision_errors import EpisodeErrors, ErrorMeter
from hrl_escape.benchmark.references.path_lengths import walk_path
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.domain import DomainStep
from hrl_escape.planning.goals import ExitGoal, PressGoal
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.sets.benchmark import load_benchmark
from tests.text.rooms import get_room, make_session


def play(name: str, room: RoomInstance, seed: int = 0) -> tuple[RoomState, list[Sequence[DomainStep]]]:
    """First state and decisions of an episode of a reference."""
    env, recorder = make_agent_env(AgentSpec(name), room, "features")
    inner: Any = env
    decisions = [inner.last_steps for _ in play_episode(make_reference(name, env, recorder), env, seed)]
    return recorder.states[0], decisions


def check_sum(errors: EpisodeErrors) -> None:
    parts = errors.exploration + errors.exploitation + errors.luck + errors.path
    assert errors.regret == pytest.approx(parts, abs=1e-4)
    assert all(min(each.exploration, each.exploitation) >= 0 for each in errors.decisions)


class Recursion:
    """Expected primitives over the orders of a chain, by plain recursion: a world is an order of its buttons."""

    def __init__(self, room: RoomInstance) -> None:
        self.room, self.planner = room, RoomPlanner(room)
        self.known: dict[Any, float] = {}

    def go(self, state: RoomState, goal: Any) -> tuple[RoomState, float]:
        after, cost = walk_path(self.planner, state._replace(puzzle=(1 << len(self.room.targets)) - 1), goal)
        assert after is not None
        return after, cost

    def divide(self, worlds: frozenset, lit: int, target: int) -> list[tuple[frozenset, int]]:
        """Worlds in which the target is next in the order, and the others."""
        right = frozenset(order for order in worlds if order[bin(lit).count("1")] == target)
        return [part for part in ((right, lit | 1 << target), (worlds - right, lit)) if part[0]]

    def expect(self, worlds: frozenset, lit: int, state: RoomState) -> float:
        count = len(self.room.targets)
        if bin(lit).count("1") == count:
            return self.go(state, ExitGoal())[1]
        key = worlds, lit, state._replace(puzzle=0, primitives=0)
        if key not in self.known:
            self.known[key] = min(self.expect_press(worlds, lit, state, target) for target in range(count)
                                  if any(order[bin(lit).count("1")] == target for order in worlds))
        return self.known[key]

    def expect_press(self, worlds: frozenset, lit: int, state: RoomState, target: int) -> float:
        after, cost = self.go(state, PressGoal(target))
        return cost + sum(len(part) / len(worlds) * self.expect(part, bits, after)
                          for part, bits in self.divide(worlds, lit, target))


@pytest.mark.nightly_for("chain-3-sweep-0", "chain-3-search-random-0")
@pytest.mark.parametrize(("rung", "player", "seed"), [("pair", "sweep", 0), ("chain-3", "sweep", 0),
                                                      ("chain-3", "search-random", 0)])
def test_errors_are_those_of_a_plain_recursion(rung: str, player: str, seed: int):
    room = get_room(rung, 1)
    start, decisions = play(player, room, seed)
    errors = ErrorMeter(room).measure(start, decisions)
    check_sum(errors)
    assert errors.path == pytest.approx(0.0, abs=1e-9) and errors.exploration > 0
    plain, worlds, lit = Recursion(room), frozenset(itertools.permutations(range(len(room.targets)))), 0
    for steps, found in zip(decisions, errors.decisions, strict=True):
        before, after, k = steps[0].state, steps[-1].next_state, len(steps)
        best = plain.expect(worlds, lit, before)
        was_fixed = len(worlds) == 1
        pressed = [i for i in range(len(room.targets)) if steps[-1].events.pressed >> i & 1 and not lit >> i & 1]
        if pressed:
            parts = plain.divide(worlds, lit, pressed[0])
            here = k + sum(len(part) / len(worlds) * plain.expect(part, bits, after) for part, bits in parts)
            worlds, lit = next(part for part in parts if part[1] == after.puzzle)
        else:
            here = k + (0.0 if steps[-1].info["is_success"] else plain.expect(worlds, lit, after))
        assert (found.exploitation if was_fixed else found.exploration) == pytest.approx(here - best, abs=1e-4)
        assert (found.exploration if was_fixed else found.exploitation) == 0


def draw_all(rung: str, number: int) -> list[RoomInstance]:
    """The room with each order of a chain, which are equally likely."""
    room = get_room(rung, number)
    puzzle: Any = room.puzzle
    return [dataclasses.replace(room, puzzle=dataclasses.replace(
        puzzle, edge_list=tuple(sorted(itertools.pairwise(order))), goal=order[-1]))
        for order in itertools.permutations(range(len(room.targets)))]


@pytest.mark.nightly
@pytest.mark.parametrize("player", ["search-nearest", "sweep"])
def test_luck_averages_to_zero_over_the_graphs_that_are_drawn(player: str):
    config = load_benchmark("ladder-1")["chain-3"].config
    found = []
    for room in draw_all("chain-3", 1):
        start, decisions = play(player, room)
        found.append(ErrorMeter(room, config).measure(start, decisions))
        check_sum(found[-1])
    assert len({each.regret for each in found}) > 2 and any(abs(each.luck) > 5 for each in found)
    assert sum(each.luck for each in found) / len(found) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.nightly
def test_the_bayes_planner_makes_no_error_and_five_buttons_sum_up():
    room = get_room("lattice-5", 1)
    meter = ErrorMeter(room)
    for player in ("bayes", "sweep-random"):
        errors = meter.measure(*play(player, room))
        check_sum(errors)
        assert (errors.exploration + errors.exploitation < 0.5) is (player == "bayes")
        assert abs(errors.path) < 12, "the lengths of the table are close"


def test_moves_wrong_calls_and_games_that_stop_are_measured():
    session = make_session(get_room("pair", 3))
    for call in (("fly", {}), ("move", {"primitive": "turn-left", "times": 5}),
                 ("run_option", {"option": "press-button-1"}), ("run_option", {"option": "press-button-1"})):
        session.call(*call)
    errors = ErrorMeter(session.env.instance).measure(session.env.start, session.env.decisions)
    check_sum(errors)
    assert len(errors.decisions) == 4 and errors.decisions[1].exploration > 0
    assert errors.decisions[0].luck == errors.decisions[1].luck == 0.0
    assert errors.decisions[3].exploitation > 0, "its first press has shown the order"


@pytest.mark.parametrize("rung", ["drift", "code", "lattice", "doors"])
def test_rooms_without_exact_beliefs_are_refused(rung: str):
    with pytest.raises(UnsupportedError, match=rung):
        ErrorMeter(get_room(rung))


def test_errors_from_actions_are_the_counts_of_their_definition():
    room = get_room("pair", 3)
    session, puzzle = make_session(room), room.puzzle
    child = getattr(puzzle, "goal") + 1  # noqa: B009  # of a puzzle of buttons
    wrong, right = f"press-button-{child}", f"press-button-{3 - child}"

    def run(*options: str) -> ActionErrors:
        session.reset(seed=0)
        for option in options:
            session.call("run_option", {"option": option})
        return estimate_errors(room, session.env.decisions)

    assert run(right, wrong, "go-to-exit") == run(wrong, right, wrong, "go-to-exit") == (0.0, 0.0)
    assert run(wrong, wrong) == (0.5, 0.0), "the second press of a button that stays off leads to no target"
    assert run(wrong, right, right) == (1 / 3, 0.0)
    assert run(right, wrong, right, "go-to-exit") == (0.0, 0.5), "the exit was open"


def test_the_page_has_the_table_of_the_benchmark():
    from benchmarks.decision_errors import Args, make_table

    found = json.loads(Args().out.read_text(encoding="utf-8"))
    page = (Path(__file__).parents[2] / "docs/exploration.md").read_text(encoding="utf-8")
    assert "\n".join(make_table(found["lines"])) in page
    for line in found["lines"]:
        parts = line["exploration"] + line["exploitation"] + line["luck"] + line["path"]
        assert line["regret"] == pytest.approx(parts, abs=1e-2)
        assert line["player"] != "bayes" or line["exploration"] + line["exploitation"] < 1
    luck = found["games"]["luck"]
    assert found["games"]["count"] == 1000 and abs(luck["mean"]) < 3 * luck["standard_error"]
