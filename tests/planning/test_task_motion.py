"""Tasks out to unified-planning with the costs of motion, strangers' plans in, failures of motion as constraints."""

from __future__ import annotations

import itertools

import pytest

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import PlanningFailed, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.scene import Scene
from hrl_escape.planning.task_motion import TaskMotionPlanner


def make_tasks(preset: str, seed: int):
    planner = RoomPlanner(generate(get_preset(preset), seed))
    return TaskMotionPlanner(planner), planner.rules.make_state(planner.instance.starts[0])


@pytest.mark.nightly
def test_fast_downward_minimises_the_primitives_of_all_legs():
    """Beside every order of the puzzle's operators, costed by the same legs."""
    tasks, start = make_tasks("clutter", 3)
    costs = tasks.compute_costs(start)
    room = tasks.planner.instance
    model, least = room.puzzle.symbolic.make_symbolic_model(), float("inf")
    for count in range(len(model.operators) + 1):
        for order in itertools.permutations(model.operators, count):
            facts, before, total = room.puzzle.symbolic.get_facts(start.puzzle), "start", 0.0
            for op in order:
                total += costs.get((before, op.name), float("inf")) if op.is_applicable(facts) else float("inf")
                facts, before = op.apply(facts), op.name
            if model.goal <= facts:
                least = min(least, total + costs[before, "go-to-exit"])
    plan = tasks.solve(start)
    names = ["start", *(part.name for part in plan.parts[:-1]), "go-to-exit"]
    assert sum(costs[leg] for leg in itertools.pairwise(names)) == least
    env = EscapeRoomEnv(instance=room)
    env.reset(options={"state": start})
    run = plan.execute(env)
    assert run.escaped and run.as_predicted
    env.close()


@pytest.mark.nightly
def test_our_problem_goes_out_and_a_strangers_plan_comes_in():
    from unified_planning.shortcuts import OneshotPlanner

    tasks, start = make_tasks("paper-two-button", 0)
    problem = tasks.make_problem(start)
    assert len(problem.quality_metrics) == 1
    with OneshotPlanner(name="fast-downward") as stranger:
        answer = stranger.solve(problem).plan
    plan = tasks.follow(start, answer)
    assert [part.name for part in plan.parts] == ["press-button-1", "press-button-2", "go-to-exit"]
    assert tasks.follow(start, ["press-button-1", "press-button-2", "go-to-exit"]).primitives == plan.primitives
    with pytest.raises(PlanningFailed) as failed:
        tasks.follow(start, ["press-button-2"])
    assert failed.value.reason is PlanningReason.PRECONDITION_UNMET
    with pytest.raises(UnknownNameError):
        tasks.follow(start, ["dance"])


@pytest.mark.nightly
def test_goals_may_be_facts_and_legs_may_be_forbidden():
    tasks, start = make_tasks("clutter", 3)
    both = tasks.solve(start, ["on(button-3)", "on(button-4)"])
    first, second = (part.name for part in both.parts)
    assert {first, second} == {"press-button-3", "press-button-4"}
    other = tasks.solve(start, ["on(button-3)", "on(button-4)"], forbidden=[("start", first)])
    assert [part.name for part in other.parts] == [second, first] or len(other.parts) > 2
    assert other.cost >= both.cost
    with pytest.raises(UnknownNameError, match="fact"):
        tasks.export(start, ["on(button-9)"])


@pytest.mark.nightly
def test_what_motion_cannot_do_is_no_action():
    """A button walled in: the escape that does not need it is found, one that needs it is refused."""
    tasks, start = make_tasks("clutter", 3)
    scene = Scene.of(tasks.planner.instance)
    button = scene.instance.targets[2]  # on the south wall; the puzzle's goal does not need it
    scene = scene.add("cage", Solid("box", button.x, button.y + 0.6, 1.4, 0.3))
    caged = TaskMotionPlanner(RoomPlanner(scene.instance))
    assert not any(name == "press-button-3" for _, name in caged.compute_costs(start))
    assert "press-button-3-from" not in caged.export(start)[0]
    assert caged.solve(start).parts[-1].name == "go-to-exit"
    with pytest.raises(PlanningFailed) as failed:
        caged.solve(start, ["on(button-3)"])
    assert failed.value.reason is PlanningReason.PRECONDITION_UNMET


def test_pushes_are_refused():
    with pytest.raises(UnsupportedError, match="pursue"):
        make_tasks("push-block", 0)
