"""Scenes: plans after any edits come true in the edited room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, UnknownNameError, UnsupportedError
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.props import get_prop_poses
from hrl_escape.planning.scene import Scene


def edit_at_random(scene: Scene, number: int, rng: np.random.Generator) -> Scene | None:
    """One edit; None if the scene refuses it."""
    extra = [name for name in scene.names if not name.startswith("wall")]
    x, y = rng.uniform(-8, 8, size=2).tolist()
    try:
        if not extra or (rng.random() < 0.4 and len(extra) < 14):
            half_x, half_y, yaw = rng.uniform((0.2, 0.2, -3), (0.9, 0.9, 3)).tolist()
            return scene.add(f"new-{number}", Solid(("box", "cylinder")[number % 2], x, y, half_x, half_y, yaw))
        name = str(rng.choice(extra))
        return scene.remove(name) if rng.random() < 0.4 else scene.move(name, x, y)
    except ConfigError:
        return None


def check_edits(preset: str, edits: int, *, executed_every: int) -> int:
    """Edit a scene, plan in every version; returns the number of plans executed in an environment."""
    instance = generate(get_preset(preset), 3)
    scene, rng, executed = Scene.of(instance), np.random.default_rng(1), 0
    state = scene.planner.rules.make_state(instance.starts[0])
    for number in range(edits):
        scene = edit_at_random(scene, number, rng) or scene
        goal = PressGoal(int(rng.integers(len(instance.targets))))
        try:
            plan = scene.planner.plan(state, goal)
        except PlanningFailed:
            continue
        for before, after in zip(plan.states, plan.states[1:], strict=False):  # by the distances, not by contacts
            away = min(math.hypot(after.x - before.x, after.y - before.y), 1.0)
            assert away <= instance.robot.move_step + 1e-9 and scene.is_free(after.x, after.y)
        if number % executed_every == 0:
            env = EscapeRoomEnv(instance=RoomInstance.from_dict(scene.instance.to_dict()))
            env.reset(options={"state": state})
            run = plan.execute(env)
            assert run.as_predicted and run.states[-1].touching >> goal.target & 1
            executed += 1
            env.close()
    return executed


@pytest.mark.in_turn
def test_plans_after_fifty_edits_come_true():
    assert check_edits("clutter", 50, executed_every=10) >= 3


@pytest.mark.slow
def test_plans_after_three_hundred_edits_come_true():
    assert check_edits("clutter", 300, executed_every=10) >= 15


def test_a_scene_is_a_value_and_knows_its_things_by_name():
    scene = Scene.of(generate(get_preset("clutter"), 3))
    table = scene.add("table", Solid("box", 0.0, 0.0, 0.5, 0.5))
    assert "table" in table.things and "table" not in scene.things and table.instance.id != scene.instance.id
    assert table.move("table", x=1.0).things["table"] == Solid("box", 1.0, 0.0, 0.5, 0.5)
    assert table.remove("table").instance.id == scene.instance.id
    assert not table.is_free(0.0, 0.0)


def test_props_and_targets_move_and_the_room_follows():
    block = Scene.of(generate(get_preset("push-block"), 0)).move("block-1", 1.0, 2.0)
    assert (block.instance.props[0].x, block.instance.props[0].y) == (1.0, 2.0)
    scene = Scene.of(generate(get_preset("paper-two-button"), 0))
    state = scene.planner.rules.make_state(scene.instance.starts[0])
    near = scene.move("button-1", y=0.8, yaw=0.0)
    assert near.planner.plan(state, "button-1").cost < scene.planner.plan(state, "button-1").cost


def test_a_block_on_its_side_keeps_its_yaw():
    env = EscapeRoomEnv("push-block", instance_seed=0)
    env.reset(seed=0)
    state = env.get_state()
    tipped = Rotation.from_euler("zx", [0.7, np.pi / 2]) * Rotation.from_euler("x", 0.2)
    props = tuple((*numbers[:3], *tipped.as_quat(), *numbers[7:]) for numbers in state.physics.props)
    state = state._replace(physics=state.physics._replace(props=props))
    along = tipped.apply([1.0, 0.0, 0.0])
    assert get_prop_poses(state, env.instance)[0][2] == pytest.approx(np.arctan2(along[1], along[0]))
    env.close()


def test_edits_that_no_room_allows_are_refused_by_name():
    instance = generate(get_preset("clutter"), 3)
    scene, start = Scene.of(instance), instance.starts[0]
    with pytest.raises(ConfigError, match="starts"):
        scene.add("table", Solid("box", start.x, start.y, 0.5, 0.5))
    with pytest.raises(ConfigError, match="gap"):
        scene.remove("wall-1")
    with pytest.raises(ConfigError, match="nothing else"):
        scene.add("obstacle-1", Solid())
    with pytest.raises(UnknownNameError, match="obstacle-1"):
        scene.remove("obstacle-99")
    with pytest.raises(UnsupportedError, match="belong to the room's puzzle"):
        scene.remove("button-1")
    pushing = Scene.of(generate(get_preset("push-block"), 0))
    with pytest.raises(UnsupportedError, match="belong to the room's puzzle"):
        pushing.remove("block-1")
    wall = next(solid for solid in pushing.instance.solids if solid.role == "wall")
    with pytest.raises(ConfigError, match="clear of walls"):
        pushing.move("block-1", wall.x, wall.y)
    with pytest.raises(ConfigError, match="off the starts"):
        pushing.move("block-1", pushing.instance.starts[0].x, pushing.instance.starts[0].y)


def test_where_the_robot_is_may_replace_the_start():
    instance = generate(get_preset("clutter"), 3)
    rules = RoomPlanner(instance).rules
    there = rules.make_state(instance.starts[0])
    for primitive in RoomPlanner(instance).plan(there, "0,-5").primitives:
        there = rules.step(there, primitive).state
    start = instance.starts[0]
    covered = Scene.of(instance, there).add("table", Solid("box", start.x, start.y, 0.3, 0.3))
    assert covered.planner.plan(there, "button-1").cost > 0
