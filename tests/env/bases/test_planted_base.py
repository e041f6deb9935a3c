"""A base of a stranger, its file and one line: engines, certificate, drawings, planner and options drive it."""

import contextlib
import dataclasses
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.conformance import compare
from examples.extend.diamond import Diamond
from hrl_escape.env.bases import bases
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import ConfigError, DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Start
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.meshes import compute_base_outline, make_base_column
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import UnsupportedError
from hrl_escape.kernels import hash_code
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.planning import RoomPlanner
from tests.forks import run_fork

ROOM = RoomConfig(room=ShapeConfig(width=8, depth=7), puzzle=ButtonsConfig(count=2))
ROOT = Path(__file__).parents[3]


@pytest.fixture
def diamond():
    bases.register("diamond", Diamond)
    yield RobotConfig(footprint="diamond", body_radius=0.5, turn_step_deg=15)
    bases.unregister("diamond")


def make_room(robot, seed=0, **parts):
    return generate(dataclasses.replace(ROOM, robot=robot, **parts), seed)


def test_a_name_that_no_base_has_is_refused():
    with pytest.raises(ConfigError, match="one of disc, rectangle"):
        RobotConfig(footprint="diamond")


@pytest.mark.nightly_for("dynamics1")
@pytest.mark.parametrize("dynamics", [DynamicsConfig(), DynamicsConfig(noise=0.1, slip=0.1)])
def test_both_engines_move_it_alike(diamond, dynamics):
    found = compare([make_room(diamond, seed, dynamics=dynamics) for seed in range(2)], 500, copies=10)
    assert not found.disagreements, found.disagreements[0]
    assert found.worst < 1e-9


@pytest.mark.parametrize(("steps", "reach"), [(0, 0.5 + 1e-3 * 2**0.5), (3, 0.5 * 2**-0.5 + 1e-3)])
def test_it_meets_a_wall_with_the_corner_or_the_side_that_it_turns_to_it(diamond, steps, reach):
    room = dataclasses.replace(make_room(diamond), solids=(Solid(x=0, y=0, half_x=0.1, half_y=20.0),))
    rules = Kinematics(room)
    after = rules.step(rules.make_state(Start(-0.8, 0.0, steps)), rules.actions.find("forward")).state
    assert -0.1 - after.x == pytest.approx(reach)


def test_bullet_steps_it_and_shows_it(diamond):
    room = make_room(diamond)
    engine, rules, rng = BulletRoom(room), Kinematics(room), np.random.default_rng(0)
    state = rules.make_state(room.starts[0])
    engine.set_state(state)
    for action in rng.integers(6, size=40).tolist():
        state = rules.step(state, action).state
        assert engine.step(action).state == state
    engine.close()
    with contextlib.closing(EscapeRoomEnv(instance=room, render_mode="rgb_array")) as env:
        env.reset(seed=0)
        assert np.asarray(env.render()).std() > 1.0
    assert compute_base_outline(diamond) == [pytest.approx(corner) for corner in
                                             ((0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5))]
    assert np.abs(make_base_column(diamond, 0.0, 1.0).vertices[:, :2]).max() == pytest.approx(0.5)


def test_rooms_are_certified_for_it_and_others_are_refused(diamond):
    assert find_unmet_constraint(make_room(diamond, 1)) is None
    with pytest.raises(ConfigError, match="inner doors or props"):
        generate(dataclasses.replace(get_preset("door-key"), robot=dataclasses.replace(
            get_preset("door-key").robot, footprint="diamond")), 0)
    with pytest.raises(ConfigError, match=r"at most robot.body_radius = 0\.5"):
        dataclasses.replace(diamond, mount_forward=0.6)
    with pytest.raises(UnsupportedError, match="do not know the base Diamond.*before they are imported"):
        BatchedOptionsEnv(1, instance=make_room(diamond)).reset(torch.tensor([0]))


def test_a_base_that_comes_after_the_planners_is_refused_by_them(diamond):
    room = make_room(diamond)
    with pytest.raises(UnsupportedError, match="before they are imported"):
        RoomPlanner(room).solve(Kinematics(room).make_state(room.starts[0]))


PROGRAM = """
import dataclasses
from hrl_escape.env.bases import bases
from examples.extend.diamond import Diamond
bases.register("diamond", Diamond)  # the line
from hrl_escape import OptionsEnv, RoomPlanner
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.lower_bounds import bound_escape

for drive, seed in (("strafing", 0), ("differential", 2)):
    robot = RobotConfig(footprint="diamond", body_radius=0.5, turn_step_deg=15, drive=drive)
    room = generate(RoomConfig(room=ShapeConfig(width=8, depth=7, rooms=2, doorway_width=1.3), robot=robot,
                               puzzle=ButtonsConfig(count=2)), seed)
    planner, state = RoomPlanner(room), Kinematics(room).make_state(room.starts[0])
    plan = planner.solve(state)
    assert planner.rules.has_escaped(plan.states[-1]) and bound_escape(room, state) <= plan.cost, plan
    env = OptionsEnv(EscapeRoomEnv(instance=room))
    env.reset(seed=0)
    names = room.puzzle.target_names
    order = [names.index(op.target) for op in room.symbolic_model.find_fewest(room.puzzle.symbolic.get_facts(
        room.puzzle.make_state()))]
    ends = [env.step(len(room.robot.actions) + number)[2] for number in (*order, len(names))]
    assert ends[-1], ends
    env.close()
print("escaped")
"""


@pytest.mark.slow
def test_planners_and_options_bring_it_out():
    """In a process of its own, for the searches are compiled with the bases that there are."""
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=ROOT, timeout=900,
                           env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert found.stdout.strip() == "escaped", found.stderr


LOADED = """
import sys, pathlib
from hrl_escape.env.bases import bases
place, code = pathlib.Path(sys.argv[1], "diamond.py"), pathlib.Path("examples/extend/diamond.py").read_text()
place.write_text(code.replace(*sys.argv[2:]))
sys.path.insert(0, sys.argv[1])
from diamond import Diamond
bases.register("diamond", Diamond)
from hrl_escape import RoomPlanner
from hrl_escape.env.presets import get_preset
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor import dijkstra, sweeps
from hrl_escape.planning.search import a_star
planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
planner.solve(planner.rules.make_state(planner.instance.starts[0]))
for kernel in (dijkstra.choose_points, a_star.expand_until_goal):
    assert kernel.stats.cache_hits and not kernel.stats.cache_misses, kernel.stats
print(*sorted(name for name in vars(sweeps) if name.startswith("Outline_")))
"""


@pytest.mark.nightly
def test_code_of_a_base_is_in_the_key_of_its_own_kernels_only(tmp_path):
    """Kernels for a disc, which the first process loads or compiles, stay valid whatever another base's code is."""
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    planner.solve(planner.rules.make_state(planner.instance.starts[0]))
    commented, changed = (run_fork(LOADED, str(tmp_path), *edit, check=True, environment=os.environ | {
        "PYTHONPATH": str(ROOT)}).stdout for edit in (("import math", "import math  # of Python"),
                                                      ("return ", "pass; return ")))
    key = f"Outline_diamond_{hash_code([ROOT / 'examples/extend/diamond.py'])}"
    assert key in commented and key not in changed and "Outline_diamond_" in changed


def test_the_cache_may_name_outlines_of_bases_that_are_gone():
    import hrl_escape.floor.sweeps as sweeps

    outline = pickle.loads(b"chrl_escape.floor.sweeps\nOutline_gone_0123456789ab\n.")
    assert outline is sweeps.Outline_gone_0123456789ab and outline(np.zeros(1)).size.shape == (1,)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sweeps.nothing  # noqa: B018  # its lookup raises
