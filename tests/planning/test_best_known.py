"""Best known returns: against an exhaustive search in a small room, bounds, option gaps, and records."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections import OrderedDict

import numpy as np
import pytest

from hrl_escape.clock import Clock
from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnknownNameError
from hrl_escape.options.best_with_options import best_return_with_options, find_best_with_options
from hrl_escape.options.option import ScriptedOption
from hrl_escape.planning import best_known
from hrl_escape.planning.best_known import best_known_return, find_best_known, record_return
from hrl_escape.planning.planner import RoomPlanner
from tests.covering import thin


@pytest.fixture(autouse=True)
def forget(monkeypatch):
    monkeypatch.setattr(best_known, "_KNOWN", OrderedDict())


def make_start(instance) -> RoomState:
    return RoomPlanner(instance).rules.make_state(instance.starts[0])


def count_fewest_by_force(rules: Kinematics, state: RoomState, most: int) -> int:
    """Breadth-first over all primitives; poses equal to a millimetre are one."""
    layer, seen = [state], set()
    for depth in range(1, most + 1):
        following = []
        for here in layer:
            for action in range(len(rules.actions)):
                step = rules.step(here, action)
                if step.terminated:
                    return depth
                after = step.state
                key = (round(after.x, 3), round(after.y, 3), after.heading_steps, after.puzzle, after.touching)
                if key not in seen:
                    seen.add(key)
                    following.append(after)
        layer = following
    raise AssertionError(f"not within {most}")


@pytest.mark.parametrize("seed", thin(range(4), 2))
def test_in_a_small_room_it_is_the_best_there_is(seed):
    """Two buttons, 5 x 5 m, quarter turns: small enough to try everything."""
    config = RoomConfig(
        room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.4, turn_step_deg=90),
        puzzle=ButtonsConfig(count=2, graph=GraphConfig(kind="chain"), buttons=Panels(width=1.0)),
        start=StartConfig(place="fixed"), exit=ExitConfig(width=1.0, depth=1.0),
    )
    instance = generate(config, seed)
    start = make_start(instance)
    fewest = count_fewest_by_force(Kinematics(instance), start, 25)
    known = find_best_known(instance, start)
    assert known.value == 100 - fewest
    assert known.upper_bound >= known.value


def plan_by_legs(planner, start):
    """The escape in the cheapest order, leg after leg, as options make it."""
    return planner.follow_goals(start, planner.order_goals(start), Clock(), planner.routes.settings)


@pytest.mark.nightly_for("paper-two-button", "bit-flip")
@pytest.mark.parametrize("name", ["paper-one-button", "paper-two-button", "bit-flip", "arm-two-button",
                                  pytest.param("four-button-chain", marks=pytest.mark.slow)])
def test_options_are_no_better_than_primitives_and_bounds_hold(name):
    instance = generate(get_preset(name), 0)
    start = make_start(instance)
    free = find_best_known(instance, start)
    press, ancestors = (find_best_with_options(instance, start, option_set).value
                        for option_set in ("press", "press-with-ancestors"))
    assert ancestors <= free.value and press <= free.value <= free.upper_bound
    assert press >= plan_by_legs(RoomPlanner(instance), start).compute_return()


def test_the_papers_room_with_one_button_is_worth_91():
    """The paper's figure: nine strafes; the geometric bound proves that nothing is better."""
    instance = generate(get_preset("paper-one-button"), 0)
    known = find_best_known(instance, make_start(instance))
    assert known.value == known.upper_bound == 91.0


@pytest.mark.nightly_for("paper-two-button")
@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button",
                                  pytest.param("four-button-chain", marks=pytest.mark.slow)])
def test_its_plan_runs_and_earns_it(name):
    instance = generate(get_preset(name), 0)
    env = EscapeRoomEnv(instance=instance)
    env.reset(seed=0)
    known = find_best_known(instance, env.get_state())
    assert known.plan is not None
    execution = known.plan.execute(env)
    assert execution.escaped and execution.as_predicted
    assert known.value == sum(execution.rewards) and known.primitives == len(execution.rewards)


def test_planning_legs_together_beats_one_after_the_other():
    instance = generate(get_preset("paper-two-button"), 0)
    assert best_known_return(instance) > best_return_with_options(instance, "press")


ORDERS = [RoomConfig(puzzle=ButtonsConfig(count=6, buttons=Panels(width=1.0), graph=GraphConfig(kind=kind)),
                     robot=RobotConfig(body_radius=0.5), room=ShapeConfig(width=14, depth=14))
          for kind in ("tree", "layered", "random")]


@pytest.mark.nightly_for("0-tree", "0-random")
@pytest.mark.parametrize("config", ORDERS, ids=lambda config: config.puzzle.graph.kind)
@pytest.mark.parametrize("seed", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_nothing_that_the_planner_or_its_options_do_beats_the_best_known(config, seed):
    """Leg by leg in the order found, by a press with its ancestors, and by presses one by one."""
    instance = generate(config, seed)
    start, planner = make_start(instance), RoomPlanner(instance)
    known, by_press = find_best_known(instance, start), find_best_with_options(instance, start, "press")
    by_ancestors = find_best_with_options(instance, start, "press-with-ancestors").value
    assert max(plan_by_legs(planner, start).compute_return(), by_ancestors) <= by_press.value
    assert max(by_press.value, planner.solve(start).compute_return()) <= known.value <= known.upper_bound
    for found in (known, by_press):
        assert found.plan is not None and found.plan.compute_return() == found.value
        assert found.plan.states[0] == start and planner.rules.has_escaped(found.plan.states[-1])


def beam_along(rules: Kinematics, start: RoomState, primitives, width: int, bin_size: float) -> int:
    """Length of the shortest escape found near a known one, by nothing but the room's own kinematics.

    Breadth-first over primitives; of each depth the states stay that have the fewest primitives left, judged by the
    nearest state of the known escape with the same puzzle: straight lines and turns to it, then its own rest.
    """
    known = [start]
    for primitive in primitives:
        known.append(rules.step(known[-1], primitive).state)
    classes, step = rules.headings // math.gcd(rules.headings, 4), rules.actions.longest
    ways = {puzzle: np.array([(s.x, s.y, s.heading_steps % classes, len(primitives) - n)
                              for n, s in enumerate(known) if s.puzzle == puzzle])
            for puzzle in {s.puzzle for s in known}}

    def estimate(state: RoomState) -> float:
        way = ways[state.puzzle]
        turns = np.abs(state.heading_steps % classes - way[:, 2])
        straight = np.hypot(way[:, 0] - state.x, way[:, 1] - state.y) / step
        return float((straight + np.minimum(turns, classes - turns) + way[:, 3]).min())

    layer = [start]
    for depth in range(1, len(primitives)):
        following = {}
        for here in layer:
            for action in rules.actions.base:
                after, _, terminated, _, _ = rules.step(here, action)
                if terminated and rules.has_escaped(after):
                    return depth
                key = (after.puzzle, math.floor(after.x / bin_size), math.floor(after.y / bin_size),
                       after.heading_steps % classes, after.touching)
                if not terminated and after.puzzle in ways and key not in following:
                    following[key] = estimate(after), after
        best = sorted(following.values(), key=lambda entry: entry[0])[:width]
        layer = [state for left, state in best if left + depth < len(primitives) + 2.5]
    return len(primitives)


@pytest.mark.nightly_for("four-button-chain-113", "four-button-chain-106", "paper-random-119")
@pytest.mark.parametrize(("name", "seed"), [("four-button-chain", 106), ("four-button-chain", 113),
                                            ("paper-random", 106), ("paper-random", 119)])
def test_no_escape_near_the_best_known_one_is_shorter(name, seed):
    instance = generate(get_preset(name), seed)
    start, rules = make_start(instance), Kinematics(instance, is_still=True)
    plan = find_best_known(instance, start).plan
    assert plan is not None
    assert beam_along(rules, start, plan.primitives, width=60, bin_size=0.1) == plan.cost


def test_orders_come_cheapest_first_and_differ():
    instance = generate(ORDERS[0], 0)
    plans = RoomPlanner(instance).list_escapes(make_start(instance), 3)
    assert len(plans) == 3 and [plan.cost for plan in plans] == sorted(plan.cost for plan in plans)
    assert len({tuple(part.name for part in plan.parts) for plan in plans}) > 1


@pytest.mark.nightly
def test_given_options_that_beat_the_plan_are_the_best_known():
    instance = generate(get_preset("four-button-chain"), 0)
    start = make_start(instance)
    known = find_best_known(instance, start)
    assert known.plan is not None
    poor = known._replace(value=known.value - 10, plan=None)
    best_known._KNOWN[instance.id, best_known.get_pose(start), start.puzzle] = poor
    script = ScriptedOption("the best", known.plan.primitives)
    assert find_best_with_options(instance, start, [script]).value == known.value
    assert find_best_known(instance, start).value == known.value


def test_given_options_are_searched_by_running_them():
    instance = generate(get_preset("paper-one-button"), 0)
    slow = [ScriptedOption("west-east", [3, 2, 2]), ScriptedOption("north", [2] * 5)]
    assert best_return_with_options(instance, slow) == 100 - 10 + 1, "two norths, the second cut short by the exit"
    assert best_return_with_options(instance, [ScriptedOption("turn", [4])]) == -1000
    with pytest.raises(UnknownNameError, match="did you mean 'press'"):
        best_return_with_options(instance, "pres")


@pytest.mark.nightly
def test_it_is_the_mean_over_the_starts():
    config = dataclasses.replace(get_preset("paper-one-button"), start=StartConfig(choices=5))
    instance = generate(config, 0)
    rules = RoomPlanner(instance).rules
    each = [best_known_return(instance, state=rules.make_state(start)) for start in instance.starts]
    assert len(set(each)) > 1 and best_known_return(instance) == pytest.approx(np.mean(each))


@pytest.mark.nightly
def test_what_no_one_can_do_is_worth_the_horizon():
    instance = generate(get_preset("paper-two-button"), 0)
    fewest = find_best_known(instance, make_start(instance)).primitives
    assert fewest is not None
    for horizon, value in ((10, -10), (fewest - 1, 1 - fewest), (fewest, 100 - fewest)):
        assert best_known_return(dataclasses.replace(instance, horizon=horizon)) == value


@pytest.mark.nightly
def test_a_better_return_is_taken_over_and_said():
    instance = generate(get_preset("paper-two-button"), 0)
    start = make_start(instance)
    before = best_known_return(instance)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not record_return(instance, start, before, "dqn"), "as good is not better"
    with pytest.warns(UserWarning, match=r"dqn, seed 3 reached a return of"):
        assert record_return(instance, start, before + 2, "dqn, seed 3")
    assert best_known_return(instance) == before + 2
    known, fewest = find_best_known(instance, start), RoomPlanner(instance).solve(start).cost
    assert known.source == "dqn, seed 3" and known.primitives is not None and known.primitives < fewest
    assert best_return_with_options(instance, "press") <= before
    best_known._KNOWN.clear()
    assert best_known_return(instance) == before, "another process"


@pytest.mark.nightly
def test_the_state_asked_for_least_recently_is_forgotten_first(monkeypatch):
    monkeypatch.setattr(best_known, "MOST_REMEMBERED", 2)
    names = ("paper-one-button", "paper-two-button", "bit-flip")
    first, second, third = (generate(get_preset(name), 0) for name in names)
    values = [best_known_return(room) for room in (first, second, first, third)]
    assert [room for room, *_ in best_known._KNOWN] == [first.id, third.id]
    assert best_known_return(second) == values[1], "planned anew, to the same return"


def test_luck_is_no_record():
    config = get_preset("paper-one-button")
    noisy = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1)), 0)
    assert not record_return(noisy, make_start(noisy), 99.0, "luck")
    moved = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, kind="physics")), 0)
    assert not record_return(moved, make_start(moved), 99.0, "luck")


