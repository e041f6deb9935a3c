"""Meshes of links: degenerate and damaged ones, and hulls that hold their points."""

# pyright: reportAttributeAccessIssue=false
# (coal and Pinocchio are compiled and carry no types)

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import coal
import numpy as np
import pinocchio
import pytest

from hrl_escape.env.config import DynamicsConfig, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import RobotError
from hrl_escape.planning.arm.shapes import THINNEST, make_hull
from tests.forks import run_fork
from tests.planning.arm.robots import make_arm, make_config, place_arm

PLATE = "v 0.2 -0.2 0\nv 0.8 -0.2 0\nv 0.8 0.2 0\nv 0.2 0.2 0\nf 1 2 3\nf 1 3 4\n"
DEGENERATE = {
    "flat": PLATE,
    "triangle": "v 0.2 -0.2 0\nv 0.8 -0.2 0\nv 0.8 0.2 0\nf 1 2 3\n",
    "line": "v 0.2 0 0\nv 0.5 0 0\nv 0.8 0 0\nf 1 2 3\n",
    "nearly flat": PLATE + "v 0.2 -0.2 1e-9\nf 1 2 5\n",
    "tilted": "v 0.2 -0.2 0.06\nv 0.8 -0.2 0.24\nv 0.8 0.2 0.24\nv 0.2 0.2 0.06\nf 1 2 3\nf 1 3 4\n",
    "tilted and doubled":
        "v 0.2 -0.2 0.06\nv 0.8 -0.2 0.24\nv 0.8 0.2 0.24\nv 0.2 0.2 0.06\nv 0.2 -0.2 0.06\nf 1 2 3\nf 5 3 4\n",
}
NEAR = """
import sys
import numpy as np
from hrl_escape.env.geometry import Solid
from tests.planning.arm.robots import make_arm, make_config, place_arm
geometry = f'<mesh filename="{sys.argv[1]}"/>'
for x, y, height in ((0.5, 0.0, 1.0), (0.5, 0.0, 0.65), (0.9, 0.0, 1.0), (0.5, 0.3, 1.0)):
    planner, state = place_arm(make_arm(geometry, place='xyz="0 0 0"'), [Solid("box", x, y, 0.05, 0.05, height=height)])
    print(int(planner.is_free(state, [0.0])))
"""


@pytest.mark.parametrize("name", DEGENERATE)
def test_meshes_without_volume_meet_what_they_touch(tmp_path: Path, name: str):
    """A post through the shape at 0.7 m, one below it, one ahead of it and one beside it."""
    mesh = tmp_path / "plate.obj"
    mesh.write_text(DEGENERATE[name])
    done = run_fork(NEAR, mesh, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0", "1", "1", "1"]


def test_a_thin_mesh_is_thickened_by_a_millimetre_at_most():
    planner, state = place_arm(make_arm('<box size="0.6 0.4 0.0001"/>'))
    assert planner.is_free(state, [0.0])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for turn in (np.eye(3), pinocchio.rpy.rpyToMatrix(0.3, 0.4, 0.5)):
        hull = make_hull(corners @ turn.T)
        for height, meets in ((4 * THINNEST, True), (6 * THINNEST, False), (-4 * THINNEST, True)):
            at = coal.Transform3s(np.eye(3), turn @ np.array([0.5, 0.5, height]))
            found = coal.collide(hull, coal.Transform3s(), coal.Sphere(1e-6), at, coal.CollisionRequest(),
                                 coal.CollisionResult())
            assert bool(found) == meets


@pytest.mark.parametrize("points", [
    np.random.default_rng(0).normal(size=(400, 3)),
    np.random.default_rng(1).uniform(size=(50, 3)) * (1.0, 0.3, 0.01),
    np.concatenate([[[math.cos(a), math.sin(a), 0.0] for a in np.linspace(0.0, 6.28, 400)], [[0.0, 0.0, 1.0]]]),
], ids=["ball", "slab", "cone with 400 edges at its tip"])
def test_a_hull_holds_its_points_and_hardly_more(points: np.ndarray):
    """Coal refuses corners with more than 255 neighbours, such as a cone's tip. A larger shape replaces these hulls."""
    hull, centre = make_hull(points), points.mean(axis=0)

    def measure(point: np.ndarray) -> float:
        result = coal.DistanceResult()
        return coal.distance(hull, coal.Transform3s(), coal.Sphere(1e-4), coal.Transform3s(np.eye(3), point),
                             coal.DistanceRequest(), result)

    for point in points:
        assert measure(centre + 0.999 * (point - centre)) < 1e-4
    size = float(np.ptp(points, axis=0).max())
    for direction in np.random.default_rng(2).normal(size=(50, 3)):
        direction /= np.linalg.norm(direction)
        far = (points @ direction).max() - centre @ direction
        assert measure(centre + (far + 0.1 * size) * direction) > 0.02 * size


# --- damaged meshes --------------------------------------------------------------------------

OUT_OF_RANGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 30000000\n"
FALSE_COUNTS = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="900000">0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor source="#a" count="300000" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 299999</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
DAMAGED = {"index.obj": OUT_OF_RANGE, "counts.dae": FALSE_COUNTS, "text.stl": "solid\n", "empty.obj": "",
           "point.obj": "v 0.5 0 0\nf 1 1 1\n",
           "nan.obj": "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"}
KINDS: tuple[Literal["kinematic", "physics"], ...] = ("kinematic", "physics")
ENGINES = """
import sys
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import FileReadError, RobotError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
kinematic, physics = map(RoomInstance.load, sys.argv[1:])

def plan():
    planner = ArmPlanner(kinematic)
    planner.is_free(planner.rules.make_state(kinematic.starts[0]), (0.0,))

def render():
    env = EscapeRoomEnv(instance=kinematic, render_mode="rgb_array")
    env.reset(seed=0)
    env.render()

for work in (plan, render, lambda: EscapeRoomEnv(instance=physics).reset(seed=0)):
    try:
        work()
    except (FileReadError, RobotError) as error:
        print(type(error).__name__, error)
"""


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_mesh_is_an_error_in_every_engine(tmp_path: Path, name: str):
    """Of a room that was saved while the mesh was whole, in a process of its own: Bullet alone would end it."""
    mesh = tmp_path / name
    mesh.write_text(PLATE)
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    urdf = make_arm(f'<mesh filename="{mesh}"/>').replace("</collision>", f"</collision><visual>{shape}</visual>")
    saved = [tmp_path / f"{kind}.json" for kind in KINDS]
    for path, kind in zip(saved, KINDS, strict=True):
        generate(RoomConfig(robot=make_config(urdf), dynamics=DynamicsConfig(kind=kind)), 0).save(path)
    mesh.write_text(DAMAGED[name])
    done = run_fork(ENGINES, *saved, timeout=120)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.strip().splitlines()
    assert len(lines) == 3, done.stdout
    assert all(name in line and line.startswith(("FileReadError", "RobotError")) for line in lines)


def test_a_damaged_mesh_of_a_urdf_is_named_with_its_link(tmp_path: Path):
    mesh = tmp_path / "index.obj"
    mesh.write_text(OUT_OF_RANGE)
    planner, state = place_arm(make_arm(f'<mesh filename="{mesh}"/>'))
    with pytest.raises(RobotError, match=r"the collision mesh of link 'boom': .*index\.obj"):
        planner.is_free(state, [0.0])


def test_a_scaled_mesh_meets_what_a_box_of_its_size_meets(tmp_path: Path):
    cube = tmp_path / "cube.obj"
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7),
             (1, 7, 5), (2, 6, 8), (2, 8, 4)]
    cube.write_text("".join("v {} {} {}\n".format(*at) for at in corners)
                    + "".join("f {} {} {}\n".format(*face) for face in faces))
    post = Solid("box", 0.6, 0.15, 0.05, 0.08, 0.4, height=2.0)
    planners = [place_arm(make_arm(shape), [post]) for shape in (
        f'<mesh filename="{cube}" scale="0.3 -0.025 0.025"/>', '<box size="0.6 0.05 0.05"/>')]
    answers = []
    for turn in np.random.default_rng(0).uniform(-0.3, 0.8, 200).tolist():
        mesh, box = (planner.is_free(state, [turn]) for planner, state in planners)
        assert mesh == box
        answers.append(mesh)
    assert 0.2 < np.mean(answers) < 0.8
