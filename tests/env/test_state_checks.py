"""States from outside: what an episode reaches passes, everything else is refused by the name of its field."""

import math

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.config import ExitConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import Kinematics, check_state
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import StateError
from hrl_escape.planning.planner import RoomPlanner
from tests.covering import thin
from tests.env.rooms import all_configs

IMPOSSIBLE = [
    ("x", math.nan), ("x", 50.0), ("x", 9.9), ("x", "1"), ("y", -math.inf), ("y", None), ("heading_steps", 36),
    ("heading_steps", 10**9), ("heading_steps", -1), ("heading_steps", 1.0), ("heading_offset", 7.0),
    ("joint_steps", (1,)), ("joint_steps", [0, 0, 0]), ("joint_steps", (0, 0, 7)), ("joint_steps", (0, 0, "a")),
    ("joint_offsets", (0.1,)), ("joint_offsets", (0.0, math.nan, 0.0)), ("puzzle", -1), ("puzzle", 4),
    ("puzzle", "on"), ("puzzle", None), ("puzzle", 10**5000), ("touching", -1), ("touching", 4), ("touching", True),
    ("primitives", -1), ("primitives", 10**30), ("noise_key", 2**64), ("noise_key", None), ("z", math.inf),
    ("pitch", 9.0), ("roll", math.nan),
]


@pytest.fixture(scope="module")
def env():
    env = EscapeRoomEnv("arm-two-button")
    env.reset(seed=0)
    yield env
    env.close()


@pytest.mark.parametrize(("field", "value"), IMPOSSIBLE, ids=range(len(IMPOSSIBLE)))
def test_an_impossible_number_is_refused_by_name_and_the_episode_goes_on(env, field, value):
    state = env.get_state()
    with pytest.raises(StateError, match=field) as refusal:
        env.set_state(state._replace(**{field: value}))
    assert len(str(refusal.value)) < 400
    assert env.get_state() is state
    env.set_state(state)


@pytest.mark.parametrize("value", [None, 5, "state", (0.0,) * 14, {}])
def test_what_is_no_state_is_refused(env, value):
    with pytest.raises(StateError, match="get_state"):
        env.set_state(value)


@pytest.mark.nightly_for("many-obstacles")
@pytest.mark.parametrize("name", thin(sorted(set(all_configs()) - {"largest"}), 6))
def test_every_state_that_an_episode_reaches_passes(name):
    config = all_configs()[name]
    if config.dynamics.kind == "physics":
        return
    rules = Kinematics(generate(config, 0))
    state, rng = rules.make_state(rules.instance.starts[0], 7), np.random.default_rng(0)
    for action in rng.integers(len(rules.actions), size=400).tolist():
        state = rules.step(state, action).state
        check_state(rules, state)


@pytest.mark.parametrize("seed", thin(range(20), 4))
def test_no_robot_stands_outside_the_walls_beside_an_alcove(seed):
    """On the alcove's far side from the room's middle, clear of every solid, and no further out than the exit."""
    config = RoomConfig(room=ShapeConfig(width=12, depth=12), exit=ExitConfig(door=True, width=3.0))
    room = generate(config, seed)
    rules, (x, y) = Kinematics(room), room.exit.centre
    state = rules.make_state(room.starts[0], 7)
    along_x = abs(x) > room.half_width  # the alcove is behind the east or the west wall
    places = [(x, y + beside) if along_x else (x + beside, y) for beside in (-4.0, 4.0)]
    for x, y in places:
        if abs(y if along_x else x) < 6:
            with pytest.raises(StateError, match="it is outside the walls"):
                check_state(rules, state._replace(x=x, y=y))
    check_state(rules, state._replace(x=room.exit.centre[0], y=room.exit.centre[1]))


@pytest.mark.nightly
def test_every_state_that_physics_reaches_passes_and_parts_of_another_room_do_not():
    env = EscapeRoomEnv("push-block")
    env.reset(seed=0)
    for action in np.random.default_rng(0).integers(env.action_space.n, size=40):
        env.step(action)
        env.set_state(env.get_state())
    state = env.get_state()
    for physics in (5, (), state.physics._replace(props=()), state.physics._replace(drive_velocities=(0.0,)),
                    state.physics._replace(drive_velocities=(0.0, math.nan, 0.0))):
        with pytest.raises(StateError, match="physics"):
            env.set_state(state._replace(physics=physics))
    env.close()


@pytest.mark.parametrize("physics", [5, (), "props"])
def test_planners_refuse_a_saved_physics_that_is_none(physics):
    planner = RoomPlanner(generate(PRESETS["push-block"](), 0))
    state = planner.rules.make_state(planner.instance.starts[0])
    assert planner.order_goals(state)
    with pytest.raises(StateError, match="physics"):
        planner.order_goals(state._replace(physics=physics))


def test_the_batched_engine_refuses_the_same_states():
    instance = generate(all_configs()["arm-two-button"], 0)
    room = TensorRoom(Rooms(2, instance=instance))
    room.reset(torch.tensor([0, 1]))
    state = room.get_room_state(1)
    for field, value in IMPOSSIBLE:
        with pytest.raises(StateError, match=field):
            room.set_room_state(0, state._replace(**{field: value}))
    room.set_room_state(0, state)
    assert room.get_room_state(0) == state


def test_reset_refuses_impossible_states_and_presets_take_their_own():
    for name in [*PRESETS][::4]:
        env = EscapeRoomEnv(name)
        env.reset(seed=1)
        env.reset(options={"state": env.get_state()})
        with pytest.raises(StateError):
            env.reset(options={"state": env.get_state()._replace(x=math.nan)})
        env.close()
