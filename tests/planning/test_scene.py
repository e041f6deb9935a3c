"""Scenes: plans after any edits are those of a planner made anew, and come true in the edited room."""

from __future__ import annotations

import itertools
import math
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import PlacedProp, RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Prop
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, UnknownNameError, UnsupportedError
from hrl_escape.options.closed_loop import pursue
from hrl_escape.planning.arm.model import ArmKinematics
from hrl_escape.planning.arm.reacher import Reacher
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


def plan_anyhow(planner: RoomPlanner, state, goal):
    try:
        return planner.plan(state, goal).primitives
    except PlanningFailed as failure:
        return failure.reason


def check_edits(preset: str, edits: int, *, executed_every: int, compared_every: int) -> int:
    """Edit a scene, plan in every version; returns the number of plans executed in an environment."""
    instance = generate(get_preset(preset), 3)
    scene, rng, executed = Scene.of(instance), np.random.default_rng(1), 0
    state = scene.planner.rules.make_state(instance.starts[0])
    for number in range(edits):
        scene = edit_at_random(scene, number, rng) or scene
        goal = PressGoal(int(rng.integers(len(instance.targets))))
        found = plan_anyhow(scene.planner, state, goal)
        if number % compared_every == 0:
            fresh = RoomPlanner(scene.instance)
            assert found == plan_anyhow(fresh, state, goal)
            for key, maker in scene.planner.routes.search._makers.items():
                new = fresh.routes.search.get_maker(*key)
                assert np.array_equal(maker.collision.distance, new.collision.distance)
                assert np.array_equal(maker.standing, new.standing) and np.array_equal(maker.points, new.points)
                assert all(map(np.array_equal, maker._get_links(), new._get_links()))
        if isinstance(found, tuple):
            plan = scene.planner.plan(state, goal)
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


@pytest.mark.nightly
def test_fifty_edits_plan_as_a_new_planner_would_and_come_true():
    assert check_edits("clutter", 50, executed_every=10, compared_every=5) >= 3


@pytest.mark.slow
def test_three_hundred_edits_plan_as_a_new_planner_would_and_come_true():
    assert check_edits("clutter", 300, executed_every=10, compared_every=10) >= 15


def test_fields_are_kept_where_an_edit_changes_no_cell_and_only_there():
    scene = Scene.of(generate(get_preset("clutter"), 0))
    scene.planner.prepare()
    before = scene.planner.routes.get_field_maker()
    button = scene.instance.targets[0]
    moved = scene.move(button.name, x=button.x + 0.01)
    after = moved.planner.routes.get_field_maker()
    assert len(after._fields) == len(before._fields) - 1  # all but the moved button's
    for key, field in after._fields.items():
        seeds = after.find_seeds(*moved.planner.routes.search.make_problem(
            moved.planner.rules.make_state(moved.instance.starts[0]), key[0]).area)
        assert field is before._fields[key] and np.array_equal(field, after.make_field(seeds))
    rng = np.random.default_rng(0)
    edited = next(found for number in range(20) if (found := edit_at_random(scene, number, rng)) is not None)
    assert not edited.planner.routes.get_field_maker()._fields


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
    assert near.planner.plan(state, "press-button-1").cost < scene.planner.plan(state, "press-button-1").cost


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


def make_block(x: float, y: float, kind: Literal["block", "plate"] = "block") -> PlacedProp:
    return PlacedProp(Prop(kind=kind, half_size=0.3 if kind == "block" else 0.75), x, y)


def test_blocks_and_plates_are_added_and_removed_and_the_puzzle_follows():
    scene = Scene.of(generate(get_preset("push-block"), 0))
    first = scene.instance.puzzle.props
    loose = scene.add("crate", make_block(2.0, 2.0))
    assert loose.instance.puzzle.symbolic.make_symbolic_model() == scene.instance.puzzle.symbolic.make_symbolic_model()
    assert loose.instance.puzzle.target_names == () and [p.name for p in loose.instance.puzzle.props][-1] == "crate"
    two = loose.add("goal", make_block(3.0, -2.0, "plate"))
    model = two.instance.puzzle.symbolic.make_symbolic_model()
    assert [op.name for op in model.operators] == ["push-block-1-onto-plate-1", "push-crate-onto-goal"]
    env = EscapeRoomEnv(instance=RoomInstance.from_dict(two.instance.to_dict()))
    env.reset(seed=0)
    seen = env.instance.puzzle.observe(env.get_state().puzzle)
    assert seen[4:6] == (-1.0, 4.0), "the crate as seen from its plate"
    env.close()
    again = two.remove("plate-1").remove("block-1")
    assert [p.name for p in again.instance.puzzle.props] == ["crate", "goal"]
    assert two.remove("goal").remove("crate").instance.id == scene.instance.id
    assert scene.instance.puzzle.props == first
    with pytest.raises(ConfigError, match="remove its plate 'goal' first"):
        two.remove("crate")
    with pytest.raises(ConfigError, match="add the block first"):
        scene.add("goal", make_block(3.0, -2.0, "plate"))
    with pytest.raises(ConfigError, match=r"puzzle\.things"):
        scene.remove("plate-1")
    wall = next(solid for solid in scene.instance.solids if solid.role == "wall")
    with pytest.raises(ConfigError, match="a centre on the floor"):
        scene.add("crate", make_block(wall.x, wall.y))
    with pytest.raises(ConfigError, match="off the starts"):
        scene.add("crate", make_block(scene.instance.starts[0].x, scene.instance.starts[0].y))
    with pytest.raises(UnsupportedError, match="no blocks or plates"):
        Scene.of(generate(get_preset("clutter"), 3)).add("crate", make_block(0.0, 0.0))


@pytest.mark.nightly
def test_a_room_with_an_added_block_and_plate_is_escaped_by_pushing_both():
    scene = Scene.of(generate(get_preset("push-block"), 14))
    room = scene.instance
    things = (*room.props, *room.starts)
    x, y = next(place for place in itertools.product((-2.0, 2.0), repeat=2)
                if all(math.hypot(thing.x - place[0], thing.y - place[1]) > 2.5 for thing in things))
    scene = scene.add("crate", make_block(x, y)).add("goal", make_block(x + 1.0, y, "plate"))
    scene = scene.add("loose", make_block(x - 1.5, y))
    env = EscapeRoomEnv(instance=scene.instance)
    env.reset(seed=14)
    run = pursue(env)
    assert run.escaped and env.instance.puzzle.is_solved(run.states[-1].puzzle)
    later = Scene.of(scene.instance, run.states[-1]).instance.props
    assert math.hypot(later[2].x - x, later[2].y - y) > 0.1, "the scene of a state has its blocks where they are"
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
    with pytest.raises(UnsupportedError, match="no arm"):
        scene.attach("obstacle-1", scene.planner.rules.make_state(start))
    with pytest.raises(UnsupportedError, match="empty"):
        scene.detach(scene.planner.rules.make_state(start))


def test_where_the_robot_is_may_replace_the_start():
    instance = generate(get_preset("clutter"), 3)
    rules = RoomPlanner(instance).rules
    there = rules.make_state(instance.starts[0])
    for primitive in RoomPlanner(instance).plan(there, "0,-5").primitives:
        there = rules.step(there, primitive).state
    start = instance.starts[0]
    covered = Scene.of(instance, there).add("table", Solid("box", start.x, start.y, 0.3, 0.3))
    assert covered.planner.plan(there, "press-button-1").cost > 0


# --- the hand ----------------------------------------------------------------------------------


def test_a_held_object_is_a_link_in_every_library_and_goes_where_the_hand_goes():
    instance = generate(get_preset("arm-two-button"), 0)
    scene = Scene.of(instance)
    rules = scene.planner.rules
    state = rules.make_state(instance.starts[0])
    hand = rules.get_hand(state)
    scene = scene.add("crate", Solid("box", hand[0] + 0.15, hand[1], 0.1, 0.1, 0.3, height=0.5))
    held = scene.attach("crate", state)
    assert "crate" not in held.things and held.held is not None
    assert held.planner.rules.get_hand(state) == hand, "the hand itself is as before"
    model = ArmKinematics(held.planner.rules.robot).model
    assert model.existFrame("held-crate")
    masses = [sum(part.mass for part in each.inertias) for each in (model, ArmKinematics(rules.robot).model)]
    assert masses[0] - masses[1] == pytest.approx(100.0 * 0.2 * 0.2 * 0.5), "kg, of a box of 0.2 x 0.2 x 0.5 m"

    turned = state._replace(heading_steps=(state.heading_steps + 9) % 36)  # a quarter turn to the left
    put = held.detach(turned).things["crate"]
    assert isinstance(put, Solid)
    assert (put.x - state.x, put.y - state.y) == pytest.approx((-(hand[1] - state.y), hand[0] + 0.15 - state.x))
    assert math.remainder(put.yaw - 0.3 - math.pi / 2, math.tau) == pytest.approx(0.0, abs=1e-9)
    back = held.detach(state)
    crate = back.things["crate"]
    assert isinstance(crate, Solid) and crate.x == pytest.approx(hand[0] + 0.15)
    assert back.instance.robot == instance.robot

    env = EscapeRoomEnv(instance=held.instance)
    env.reset(options={"state": state})
    run = held.planner.plan(state, "press-button-1").execute(env)
    assert run.as_predicted
    plans = [each.planner.plan(state, "press-button-1") for each in (held, scene)]
    assert plans[0].primitives == plans[1].primitives
    env.close()


def test_an_object_stays_in_the_hand_when_a_button_moves():
    instance = generate(get_preset("arm-two-button"), 0)
    state = Scene.of(instance).planner.rules.make_state(instance.starts[0])
    x, y, _ = Kinematics(instance).get_hand(state)
    held = Scene.of(instance).add("crate", Solid("box", x, y, 0.1, 0.1)).attach("crate", state)
    assert held.move("button-1", y=0.8).held is held.held is not None


def test_a_held_object_collides_where_the_empty_hand_does_not():
    instance = generate(get_preset("arm-two-button"), 0)
    rules = RoomPlanner(instance).rules
    state = rules.make_state(instance.starts[0])
    hand, angles, heading = rules.get_hand(state), rules.get_angles(state), rules.get_heading(state)
    ahead_x, ahead_y = math.cos(heading), math.sin(heading)

    def place(distance: float, half: float) -> Solid:
        """A box ahead of the hand."""
        return Solid("box", hand[0] + distance * ahead_x, hand[1] + distance * ahead_y, half, 0.05, heading,
                     height=2 * hand[2])

    scene = Scene.of(instance)
    held = scene.add("pole", place(0.6, 0.55)).attach("pole", state)
    for room, is_free in ((scene.add("post", place(1.0, 0.1)), True), (held, True),
                          (held.add("post", place(1.0, 0.1)), False)):
        reacher = Reacher(room.instance)
        assert reacher.is_collision_free(state.x, state.y, heading, angles) == is_free
