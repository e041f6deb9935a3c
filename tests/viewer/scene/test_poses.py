"""The scene shows the robot, the door and the walls where the room has them."""

from __future__ import annotations

import dataclasses
import math
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hrl_escape.env.config import RobotConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.model import RoomModel
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.viewer.scene import (
    OVERVIEW_FIELD,
    ArmPose,
    RoomScene,
    blend,
    compute_overview,
    is_hidden_by,
    make_arm_shapes,
    make_base_shapes,
    make_confetti,
    make_fixtures,
    to_quaternion,
)

ROBOTS = [RobotConfig(joints=1), RobotConfig(joints=3, link_length=0.5), RobotConfig(joints=7),
          RobotConfig(kind="kuka-iiwa", joints=7), RobotConfig(kind="franka-panda", joints=7)]


@pytest.mark.parametrize("config", ROBOTS, ids=lambda c: f"{c.kind}-{c.joints}")
def test_the_drawn_hand_is_where_the_rules_have_it(config: RobotConfig):
    robot = make_robot(config)
    low, high = np.array(robot.limits).T
    for angles in np.random.default_rng(0).uniform(low, high, size=(20, len(low))):
        placement = ArmPose(robot).compute(angles.tolist())[robot.hand_link]
        np.testing.assert_allclose(placement[:3, 3], robot.compute_hand(angles), atol=1e-9)


@pytest.mark.parametrize("config", ROBOTS, ids=lambda c: f"{c.kind}-{c.joints}")
def test_every_robot_has_shapes_for_base_and_arm(config: RobotConfig):
    robot = make_robot(config)
    base = np.concatenate([shape.vertices for shape in make_base_shapes(config)])
    assert np.hypot(base[:, 0], base[:, 1]).max() == pytest.approx(config.body_radius, rel=0.02)
    arm = make_arm_shapes(robot, config)
    assert len({shape.link for shape in arm}) > config.joints and all(len(shape.faces) for shape in arm)


def test_quaternions_agree_with_rotation_matrices():
    for angles in np.random.default_rng(1).uniform(-3, 3, size=(20, 3)):
        x, y, z, w = Rotation.from_euler("xyz", angles).as_quat()
        ours = np.array(to_quaternion(*angles))
        assert abs(abs(ours @ (w, x, y, z)) - 1) < 1e-12


def test_motion_starts_and_ends_at_the_states_and_turns_the_short_way():
    rules = Kinematics(generate(get_preset("paper-one-button"), 0))
    start = rules.make_state(rules.instance.starts[0])
    before = start._replace(heading_steps=35)
    after = start._replace(heading_steps=1, x=start.x + 1.0)
    model = RoomModel(rules.instance)
    a, b = model.make_pose(before), model.make_pose(after)
    assert blend(a, b, 0.0) == a
    end = blend(a, b, 1.0)
    assert (end.x, end.y) == (b.x, b.y) and math.cos(end.heading - b.heading) == pytest.approx(1.0)
    middle = blend(a, b, 0.5)
    assert middle.x == pytest.approx(start.x + 0.5) and math.cos(middle.heading) == pytest.approx(1.0)


def test_the_door_opens_outwards_when_the_puzzle_is_solved():
    instance = generate(get_preset("clutter"), 3)
    rules = Kinematics(instance)
    state = rules.make_state(instance.starts[0])
    model = RoomModel(instance)
    assert model.make_pose(state).door == 0.0
    puzzle = state.puzzle
    for _ in instance.targets:
        for operator in instance.puzzle.symbolic.make_symbolic_model().operators:
            if operator.is_applicable(instance.puzzle.symbolic.get_facts(puzzle)):
                target = instance.puzzle.target_names.index(operator.target)
                puzzle = instance.puzzle.update(puzzle, Contacts((target,)))
    assert instance.puzzle.is_solved(puzzle)
    pose, door = model.make_pose(state._replace(puzzle=puzzle)), instance.door
    assert door is not None and abs(pose.door) == pytest.approx(math.pi / 2)
    hinge = np.array([door.x - math.cos(door.yaw) * door.half_x, door.y - math.sin(door.yaw) * door.half_x])
    tip = hinge + 2 * door.half_x * np.array([math.cos(door.yaw + pose.door), math.sin(door.yaw + pose.door)])
    exit_ = np.array(instance.exit.centre)
    assert np.linalg.norm(tip - exit_) < np.linalg.norm(np.array([door.x, door.y]) - exit_) + door.half_x


@pytest.mark.parametrize("preset", ["paper-two-button", "clutter"])
def test_outer_walls_are_opaque_only_from_inside(preset: str):
    instance = generate(get_preset(preset), 3)
    parts = {painted.name: painted for painted in make_fixtures(RoomModel(instance))}
    inside, outside = parts["walls/inside"], parts["walls/outside"]
    assert inside.opacity is None and outside.opacity is not None and outside.opacity < 0.3
    for mesh, towards in ((inside.mesh, -1.0), (outside.mesh, 1.0)):
        corners = mesh.vertices[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middles = corners.mean(axis=1)
        half = (instance.half_width, instance.half_depth)
        big = (np.abs(middles[:, :2]) / half).max(axis=1) > 0.99
        along = (normals[:, :2] * middles[:, :2]).sum(axis=1)[big & (np.linalg.norm(normals, axis=1) > 8.0)]
        assert len(along) and (np.sign(along) == towards).all(), "the long faces point to the side they are seen from"


@pytest.mark.parametrize("name", ["paper-two-button", "clutter"])
def test_on_an_upright_screen_the_whole_floor_is_seen_above_the_panel(name: str):
    instance, aspect = generate(get_preset(name), 0), 390 / 844
    place, target = map(np.array, compute_overview(instance, aspect))
    ahead = (target - place) / np.linalg.norm(target - place)
    up = np.cross((1.0, 0.0, 0.0), ahead)
    lens = np.tan(np.radians(OVERVIEW_FIELD / 2))
    for x in (-instance.reach_x, instance.reach_x):
        for y in (-instance.reach_y, instance.reach_y):
            sight = np.array((x, y, 0.0)) - place
            across, high = sight[0] / (sight @ ahead) / lens / aspect, sight @ up / (sight @ ahead) / lens
            assert abs(across) < 1.0 and 0.2 < high < 1.0, "the panel covers the lower 60 %"


@pytest.mark.parametrize(("width", "depth"), [(8.0, 8.0), (40.0, 5.0), (5.0, 40.0)])
def test_the_whole_floor_is_seen_on_a_wide_screen(width: float, depth: float):
    config = dataclasses.replace(get_preset("paper-one-button"), room=ShapeConfig(width=width, depth=depth))
    instance, aspect = generate(config, 0), 1.6
    place, target = map(np.array, compute_overview(instance, aspect))
    ahead = (target - place) / np.linalg.norm(target - place)
    up, lens = np.cross((1.0, 0.0, 0.0), ahead), np.tan(np.radians(OVERVIEW_FIELD / 2))
    for x in (-instance.reach_x, instance.reach_x):
        for y in (-instance.reach_y, instance.reach_y):
            sight = np.array((x, y, 0.0)) - place
            assert sight @ ahead > 0
            across, high = sight[0] / (sight @ ahead) / lens / aspect, sight @ up / (sight @ ahead) / lens
            assert max(abs(across), abs(high)) < 1.0


def test_links_of_our_own_arms_are_drawn_slim_and_others_as_they_are():
    generated = RobotConfig(joints=3, link_length=0.5)
    robot = make_robot(generated)
    given = dataclasses.replace(generated, kind="urdf", urdf=robot.urdf)
    radius = float(ElementTree.fromstring(robot.urdf).findall("link[@name='arm-1']//cylinder")[0].get("radius", 0))
    for config, share in ((generated, 0.7), (given, 1.0)):
        link = next(shape for shape in make_arm_shapes(robot, config) if shape.link == "arm-1")
        assert np.ptp(link.vertices, axis=0).min() == pytest.approx(2 * share * radius, rel=0.01)


def test_names_over_targets_tell_what_these_show(server):
    room = generate(get_preset("recipes"), 0)
    scene = RoomScene(server, room)
    state = Kinematics(room).make_state(room.starts[0])
    for stored in (0, 3):
        scene.show(state._replace(puzzle=stored))
        labels = [handle.text for name, handle in server.scene._handle_from_node_name.items() if name.endswith("/name")
                  and "/targets/" in name]
        assert labels[0] == ("wood: 3" if stored else "wood") and "diamond \N{BLACK STAR}" in labels


def test_the_exit_has_the_colour_of_its_lock(server, clutter):
    scene = RoomScene(server, clutter)
    state = scene.rules.make_state(clutter.starts[0])
    solved = state._replace(puzzle=RoomPlanner(clutter).orders.solved_puzzle)
    for each, colour in ((state, palette.EXIT_LOCKED), (solved, palette.EXIT_OPEN), (state, palette.EXIT_LOCKED)):
        scene.light(each)
        red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
        assert {tuple(part.color) for part in scene._exit} == {(red, green, blue)}


def test_each_goal_has_its_label_where_it_is_and_loses_it(server, clutter):
    def list_labels() -> dict[str, str]:
        nodes = server.scene._handle_from_node_name.items()
        return {name.rpartition("goals/")[2]: handle.text for name, handle in nodes
                if "/goals/" in name and hasattr(handle, "text")}

    scene = RoomScene(server, clutter)
    scene.draw_goals([("leave", 1.0, 2.0), ("press", -3.0, 2.0), ("go", 1.0, 2.0)])
    assert list_labels() == {"1/2": "leave, go", "-3/2": "press"}
    scene.draw_goals([("press", -3.0, 2.0), ("go", 1.0, 2.0)])
    assert list_labels() == {"1/2": "go", "-3/2": "press"}
    scene.draw_goals([])
    assert not list_labels()


def test_an_obstacle_between_camera_and_robot_turns_to_glass_and_back(server, clutter):
    scene = RoomScene(server, clutter)
    pose = scene.model.make_pose(scene.rules.make_state(clutter.starts[0]))
    part, node = scene._obstacles[0]
    solid = part.shape
    beside = (solid.x + 3 * solid.half_x, solid.y)
    behind = pose._replace(x=2 * solid.x - beside[0], y=solid.y)
    scene.uncover([(*beside, 0.3)], behind)
    assert node.opacity < 0.5
    scene.uncover([(*beside, 0.3)], behind._replace(x=beside[0], y=solid.y + 2.0))
    assert node.opacity is None
    assert not is_hidden_by(part, (*beside, 40.0), (*beside, 0.3)), "from right above it sees over"


def test_confetti_begins_at_the_exit_rises_and_comes_down(clutter):
    centre = clutter.exit.centre
    begin, middle, end = (make_confetti(centre, share) for share in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(begin[:, :2], np.broadcast_to(centre, begin[:, :2].shape), atol=1e-6)
    assert middle[:, 2].min() > 1.0 and end[:, 2].max() < 0.1
