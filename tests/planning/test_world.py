"""Worlds without a puzzle: maps of map_server, solids, and plans and trajectories in the map's frame."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from hrl_escape.agents import train
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.maps import draw_room, save_map
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.urdf import LARGEST_VISUAL
from hrl_escape.errors import ConfigError, FileReadError, UnsupportedError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.goals import PoseGoal
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.world import World, merge_cells, split_triangles

ROBOT = RobotConfig(body_radius=0.3, move_step=0.25)


def write_map(folder, **changes):
    """A walled map of 10 x 8 m at 5 cm with a wall in its middle, and a patch that is unknown."""
    grey = np.full((160, 200), 254, np.uint8)
    grey[:2], grey[-2:], grey[:, :2], grey[:, -2:] = 0, 0, 0, 0
    grey[40:120, 98:102] = 0
    grey[20:30, 150:170] = 205
    Image.fromarray(grey).save(folder / "map.pgm")
    about = {"image": "map.pgm", "resolution": 0.05, "origin": "[-3.0, 2.0, 0.0]", "negate": 0,
             "occupied_thresh": 0.65, "free_thresh": 0.196} | changes
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in about.items()))
    return folder / "map.yaml"


def test_rectangles_cover_exactly_the_occupied_cells():
    rng = np.random.default_rng(0)
    for share in (0.0, 0.3, 0.8, 1.0):
        cells = rng.random((17, 23)) < share
        covered = np.zeros(cells.shape, dtype=int)
        boxes = list(merge_cells(cells))
        for a, b, c, d in boxes:
            covered[c:d, a:b] += 1
        assert (covered == cells).all()
    assert list(merge_cells(np.ones((4, 5), dtype=bool))) == [(0, 5, 0, 4)]


@pytest.mark.nightly
def test_a_map_of_ros_is_planned_in_its_own_frame(tmp_path):
    world = World.read(write_map(tmp_path), ROBOT, (-1.0, 4.0, 0.5))
    start = world.make_state(-1.0, 4.0, 0.5)
    goal = world.goal(5.0, 4.0, tolerance=0.2)
    trajectory = make_trajectory(RoomPlanner(world.instance).plan(start, goal))
    places = world.to_map(trajectory.sample(50)[1])
    assert places[0] == pytest.approx([-1.0, 4.0, 0.5]) and np.hypot(*(places[-1, :2] - (5.0, 4.0))) <= 0.2
    wall = Solid("box", 2.0, 6.0, 0.1, 2.0).footprint  # columns 98 to 102 of 5 cm, right of x = -3
    assert min(compute_distance(x, y, wall) for x, y in places[:, :2].tolist()) >= 0.3
    assert places[:, 1].min() < 4.0 - 0.2 or places[:, 1].max() > 8.0 + 0.2, "round the wall's end"


def test_what_the_map_does_not_know_is_solid_unless_it_is_said_to_be_free(tmp_path):
    path = write_map(tmp_path)
    unknown = (5.0, 8.8)  # image rows count from the top
    with pytest.raises(ConfigError, match="start = "):
        World.read(path, ROBOT, (*unknown, 0.0))
    assert World.read(path, ROBOT, (*unknown, 0.0), unknown_is_free=True).instance.starts


def write_mesh(path, boxes):
    """An OBJ file of boxes (x_min, x_max, y_min, y_max, z_min, z_max), each closed."""
    lines = []
    for number, (x_min, x_max, y_min, y_max, z_min, z_max) in enumerate(boxes):
        lines += [f"v {x} {y} {z}" for x in (x_min, x_max) for y in (y_min, y_max) for z in (z_min, z_max)]
        faces = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
        lines += ["f " + " ".join(str(8 * number + corner + 1) for corner in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


HALL = (-3.0, 7.0, 2.0, 10.0, -0.1, 0.0)  # its floor


def test_a_mesh_is_as_high_as_it_is_over_each_cell_and_grows_by_two_cells_at_most(tmp_path):
    rng, cell = np.random.default_rng(1), 0.1
    boxes = [(x, x + rng.uniform(0.2, 1.5), y, y + rng.uniform(0.2, 1.5), 0.0, rng.uniform(0.1, 1.9))
             for x, y in rng.uniform((-1.0, 3.5), (5.0, 8.0), (6, 2))]
    world = World.of_mesh(write_mesh(tmp_path / "hall.obj", [HALL, *boxes]), ROBOT, (-2.5, 2.5, 0.0), cell=cell)
    things = [solid for solid in world.instance.solids if solid.role == "obstacle"]
    assert world.centre == pytest.approx((2.0, 6.0))
    for x, y in rng.uniform((-2.9, 2.1), (6.9, 9.9), (3_000, 2)):
        under = [box for box in boxes if box[0] < x < box[1] and box[2] < y < box[3]]
        near = [box for box in boxes if box[0] - 2 * cell < x < box[1] + 2 * cell
                and box[2] - 2 * cell < y < box[3] + 2 * cell]
        at = world.to_room([x, y]).tolist()
        found = max((solid.height for solid in things if compute_distance(*at, solid.footprint) == 0.0), default=0.0)
        assert found >= max((box[5] for box in under), default=0.0) - 1e-5
        assert found <= max((box[5] for box in near), default=-cell) + cell + 1e-5


@pytest.mark.nightly
def test_a_room_scanned_as_a_mesh_is_planned_in(tmp_path):
    wall, table, lamp = (2.0, 2.2, 4.0, 8.0, 0.0, 1.5), (4.0, 5.0, 8.0, 9.0, 0.7, 0.75), (3.0, 4.0, 3.0, 4.0, 2.2, 2.4)
    path = write_mesh(tmp_path / "hall.obj", [HALL, wall, table, lamp])
    world = World.of_mesh(path, ROBOT, (-1.0, 4.0, 0.5))
    heights = {round(solid.height, 2) for solid in world.instance.solids if solid.role == "obstacle"}
    assert heights == {1.5, 0.75}  # the lamp hangs above two metres
    low = [solid for solid in world.instance.solids if solid.role == "obstacle" and solid.height < 0.8]
    ends = [(solid.x + side * solid.half_x, solid.y + side * solid.half_y) for solid in low for side in (-1, 1)]
    ends = world.to_map(np.array([np.min(ends, axis=0), np.max(ends, axis=0)]))
    assert np.abs(ends - [[4.0, 8.0], [5.0, 9.0]]).max() < 0.051, "on the lines of cells nothing grows by more than one"
    start, goal = world.make_state(-1.0, 4.0, 0.5), PoseGoal(*world.to_room([5.0, 4.0]).tolist(), tolerance=0.2)
    places = world.to_map(make_trajectory(RoomPlanner(world.instance).plan(start, goal)).sample(50)[1])
    assert min(compute_distance(x, y, Solid("box", 2.1, 6.0, 0.1, 2.0).footprint) for x, y in places[:, :2]) >= 0.3
    assert np.hypot(*(places[-1, :2] - (5.0, 4.0))) <= 0.2
    with pytest.raises(ConfigError, match="start = "):
        World.of_mesh(path, ROBOT, (4.5, 8.5, 0.0))


def test_a_saved_world_is_loaded_and_trained_in(tmp_path):
    world = World.of([Solid("box", 1.0, 1.0)], RobotConfig(), (-2.0, -2.0, 0.0), floor=(-4.0, 4.0, -4.0, 4.0))
    world.instance.save(tmp_path / "world.json")
    room = RoomInstance.load(tmp_path / "world.json")
    assert room == world.instance
    assert RoomPlanner(room).plan(world.make_state(-2.0, -2.0), PoseGoal(2.0, -2.0)).primitives
    assert train("q-learning", EscapeRoomEnv(instance=room), primitives=20, eval_episodes=0).primitives == 20


@pytest.mark.nightly
def test_a_map_of_a_world_shows_no_exit(tmp_path):
    world = World.of([], RobotConfig(body_radius=0.3), (0.0, 0.0, 0.0), floor=(-2.0, 2.0, -2.0, 2.0))
    words = {}
    for name, instance in (("world", world.instance), ("room", generate(get_preset("paper-one-button"), 0))):
        save_map(tmp_path / f"{name}.svg", instance)
        axes = Figure().add_subplot()
        draw_room(axes, instance, Kinematics(instance).make_state(instance.starts[0]))
        words[name] = (set(re.findall(r"<!-- (.*?) -->", (tmp_path / f"{name}.svg").read_text())),
                       {text.get_text() for text in axes.texts})
    assert "exit" in words["room"][0] and "exit" in words["room"][1], "in the legend and on the floor"
    assert "exit" not in words["world"][0] | words["world"][1] and "robot" in words["world"][0]


@pytest.mark.nightly
def test_steps_tall_walls_and_slanted_ones_become_columns(tmp_path):
    step, sill, tower = (0.0, 1.0, 3.0, 4.0, 0.0, 0.02), (2.0, 3.0, 3.0, 4.0, 0.0, 0.03), (4.0, 5.0, 3.0, 4.0, 0.0, 3.0)
    path = write_mesh(tmp_path / "hall.obj", [HALL, step, sill, tower])
    def list_heights(**given):
        world = World.of_mesh(path, ROBOT, (-1.0, 4.0, 0.5), **given)
        return {round(solid.height, 2) for solid in world.instance.solids if solid.role == "obstacle"}

    assert list_heights() == {0.05, 2.0} and list_heights(below=2.5) == {0.05, 2.5}
    lines = ["solid slanted"]  # a wall from (0, 4) to (3, 7), a roof that rises from 1 to 3 m, and a floor: an STL file
    for corners in ([(0, 4, 0), (3, 7, 0), (3, 7, 1)], [(0, 4, 0), (3, 7, 1), (0, 4, 1)],
                    [(4, 3, 1), (6, 3, 3), (6, 4, 3)], [(4, 3, 1), (6, 4, 3), (4, 4, 1)],
                    [(-3, 2, 0), (7, 2, 0), (7, 10, 0)], [(-3, 2, 0), (7, 10, 0), (-3, 10, 0)]):
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in corners), "endloop",
                  "endfacet"]
    (tmp_path / "slanted.stl").write_text("\n".join([*lines, "endsolid slanted"]))
    world = World.of_mesh(tmp_path / "slanted.stl", ROBOT, (-1.0, 3.0, 0.5))
    things = [solid.footprint for solid in world.instance.solids if solid.role == "obstacle"]
    low, high = world.to_room([[4.5, 3.5], [5.5, 3.5]]).tolist()
    assert min(compute_distance(*low, thing) for thing in things) == 0.0
    assert min(compute_distance(*high, thing) for thing in things) > 0.3, "the roof is above two metres there"
    for share, away in np.random.default_rng(0).uniform((0.0, 0.1), (1.0, 1.0), (500, 2)):
        on, off = world.to_room([[3 * share, 4 + 3 * share], [3 * share + away, 4 + 3 * share - away]]).tolist()
        assert min(compute_distance(*on, thing) for thing in things) == 0.0
        assert min(compute_distance(*off, thing) for thing in things) > 0.0, "two cells from the wall"


def test_triangles_are_split_until_no_edge_is_too_long():
    corners = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3, 3))
    parts = split_triangles(corners, 0.2)
    edges = np.linalg.norm(np.roll(parts, -1, axis=1) - parts, axis=2)
    areas = [np.linalg.norm(np.cross(each[:, 1] - each[:, 0], each[:, 2] - each[:, 0]), axis=1).sum()
             for each in (corners, parts)]
    assert edges.max() <= 0.2 and len(parts) > 500 and areas[0] == pytest.approx(areas[1])
    assert split_triangles(corners[:0], 0.2).shape == (0, 3, 3)


def test_what_is_no_mesh_or_leaves_nothing_on_the_floor_is_refused(tmp_path):
    (tmp_path / "text.obj").write_text("hello")
    for name, match in (("text.obj", "is no mesh"), ("missing.stl", "no such mesh")):
        with pytest.raises(FileReadError, match=match):
            World.of_mesh(tmp_path / name, ROBOT, (0.0, 0.0, 0.0))
    (tmp_path / "room.zip").write_bytes(b"PK")
    with pytest.raises(FileReadError, match="must end in one of"):
        World.of_mesh(tmp_path / "room.zip", ROBOT, (0.0, 0.0, 0.0))
    with open(tmp_path / "endless.stl", "wb") as file:
        file.truncate(LARGEST_VISUAL + 1)
    with pytest.raises(FileReadError, match="endless.stl.*bytes"):
        World.of_mesh(tmp_path / "endless.stl", ROBOT, (0.0, 0.0, 0.0))
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 1 0 1\nv nan 0 1\nf 1 2 3\n")
    with pytest.raises(FileReadError, match="not a finite number"):
        World.of_mesh(tmp_path / "nan.obj", ROBOT, (0.0, 0.0, 0.0))
    bare = write_mesh(tmp_path / "bare.obj", [HALL])
    with pytest.raises(ConfigError, match="above its floor"):
        World.of_mesh(bare, ROBOT, (0.0, 4.0, 0.0))
    for wrong in ({"cell": 0.0}, {"below": 0.0}, {"below": np.inf}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            World.of_mesh(bare, ROBOT, (0.0, 4.0, 0.0), **wrong)
    wall = tuple(1000.0 * number for number in (2.0, 2.2, 4.0, 8.0, 0.0, 1.5))
    large = write_mesh(tmp_path / "large.obj", [tuple(1000.0 * number for number in HALL), wall])
    with pytest.raises(ConfigError, match="not millimetres"):
        World.of_mesh(large, ROBOT, (0.0, 4.0, 0.0))


def test_a_world_is_an_environment_and_an_arm_s_place_too():
    robot = RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5)
    world = World.of([Solid("cylinder", 12.0, 21.2, 0.1, 0.1, height=1.5)], robot, (10.0, 20.0, 0.0),
                     floor=(5.0, 15.0, 16.0, 24.0))
    home = np.array(world.make_state(10.0, 20.0).joint_steps)
    state = world.make_state(10.0, 20.0, 1.0, (0.1, 0.2, 0.0, -1.5, 0.0, 1.6, 0.0))
    arm = ArmPlanner(world.instance)
    assert home.shape == (7,) and arm.rules.get_angles(state) == pytest.approx((0.1, 0.2, 0.0, -1.5, 0.0, 1.6, 0.0))
    assert make_trajectory(arm.plan(state, (0.5, 0.2, 0.0, -1.5, 0.0, 1.6, 0.0))).duration > 0.3
    env = EscapeRoomEnv(instance=world.instance)
    env.reset(options={"state": state})
    steps = [env.step(0) for _ in range(20)]
    assert not any(step[2] for step in steps) and env.get_state().y == pytest.approx(4.0 - 0.4 - 1e-3, abs=0.01)


def test_impossible_states_are_refused():
    world = World.of([], RobotConfig(joints=2), (0.0, 0.0, 0.0), floor=(-4.0, 4.0, -4.0, 4.0))
    for angles in ((0.1,), (0.1, 0.2, 0.3), (0.1, np.nan), "ab"):
        with pytest.raises(ConfigError, match=r"^angles = .*2 finite numbers"):
            world.make_state(0.0, 0.0, 0.0, angles)
    with pytest.raises(ConfigError, match=r"^pose = .*3 finite numbers"):
        world.make_state(0.0, np.inf)


def test_a_map_of_too_many_single_cells_is_refused(tmp_path):
    path = write_map(tmp_path)
    Image.fromarray(np.kron(np.ones((500, 500)), [[0, 254], [254, 0]]).astype(np.uint8)).save(tmp_path / "map.pgm")
    with pytest.raises(ConfigError, match=r"boxes = .*more than 100,000.* at most 100,000 of solid cells"):
        World.read(path, ROBOT, (1.0, 4.0, 0.0))


def test_impossible_worlds_are_refused(tmp_path):
    for start in ((1.0, 4.0, np.nan), (100.0, 100.0, 0.0), (1.0, 4.0), ("a", 0.0, 0.0)):
        with pytest.raises(ConfigError, match="^start = "):
            World.read(write_map(tmp_path), ROBOT, start)
    with pytest.raises(ConfigError, match="floor"):
        World.of([], ROBOT, (0.0, 0.0, 0.0), floor=(1.0, 0.0, 0.0, 1.0))


@pytest.mark.nightly
def test_goals_and_messages_of_ros_are_in_the_frame_of_the_map():
    """The floor's centre is at (2, 6)."""
    world = World.of([], ROBOT, (-1.0, 4.0, 0.5), floor=(-3.0, 7.0, 2.0, 10.0))
    goal = world.goal(5.0, 7.0, 1.0, tolerance=0.2)
    assert goal == PoseGoal(3.0, 1.0, 1.0, tolerance=0.2) and world.goal(5.0, 7.0).heading is None
    plan = RoomPlanner(world.instance).plan(world.make_state(-1.0, 4.0, 0.5), goal)
    trajectory = make_trajectory(plan)
    times, positions, velocities = trajectory.sample(10)
    message, path = world.to_ros(trajectory, 10), world.to_path(trajectory)
    base = message["multi_dof_joint_trajectory"]
    assert base["header"]["frame_id"] == path["header"]["frame_id"] == "map"
    assert len(base["points"]) == len(path["poses"]) == len(times) > 10
    for time, (x, y, heading), rates, point, stamped in zip(
            times, positions, velocities, base["points"], path["poses"], strict=True):
        transform, pose = point["transforms"][0], stamped["pose"]
        assert pose["position"] == transform["translation"]
        assert (pose["position"]["x"], pose["position"]["y"]) == pytest.approx((x + 2.0, y + 6.0))
        turn = pose["orientation"]
        assert turn == transform["rotation"]
        assert np.remainder(2 * np.arctan2(turn["z"], turn["w"]) - heading + 1.0, np.pi * 2) == pytest.approx(1.0)
        assert point["velocities"][0]["linear"]["x"] == pytest.approx(rates[0])
        stamp = stamped["header"]["stamp"]
        assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(time)
        assert stamped["header"]["frame_id"] == "map"
    end = world.to_pose(plan.states[-1], frame="odom")
    assert end["header"]["frame_id"] == "odom"
    at = end["pose"]["position"]
    assert np.hypot(at["x"] - 5.0, at["y"] - 7.0) <= 0.2
    assert json.loads(json.dumps([message, path, end])) == [message, path, end]
    room = trajectory.to_ros(10)["multi_dof_joint_trajectory"]
    assert room["header"]["frame_id"] == "room"
    assert room["points"][0]["transforms"][0]["translation"] == {"x": -3.0, "y": -2.0, "z": 0.0}


def test_a_trajectory_of_an_arm_has_joints_in_any_frame_and_no_path():
    robot = RobotConfig(kind="arm", joints=2, body_radius=0.3)
    world = World.of([], robot, (0.0, 0.0, 0.0), floor=(-3.0, 7.0, -3.0, 10.0))
    trajectory = make_trajectory(ArmPlanner(world.instance).plan(world.make_state(0.0, 0.0), (0.3, 0.2)))
    joints = world.to_ros(trajectory)["joint_trajectory"]
    assert joints["header"]["frame_id"] == "map" and joints["joint_names"] == ["joint-1", "joint-2"]
    assert joints["points"][-1]["positions"] == pytest.approx([0.3, 0.2])
    with pytest.raises(UnsupportedError, match="moves the arm alone"):
        world.to_path(trajectory)
