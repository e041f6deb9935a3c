"""Bullet's cameras: they show the state, change nothing, and see the robot wherever it is."""

import functools
import gc
import hashlib
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pybullet
import pytest

from hrl_escape.env.bullet import cameras as bullet_cameras
from hrl_escape.env.bullet.cameras import BulletRenderer, soften_edges
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.engine import CAMERAS, film
from hrl_escape.env.pictures import palette
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.primitives import make_action_table
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ClosedError, ConfigError, UnknownNameError, UnsupportedError
from tests.covering import thin
from tests.env.rooms import EXTREMES, all_configs


def make_room(name, seed=3):
    return BulletRoom(generate(all_configs()[name], seed))


@functools.lru_cache(maxsize=4)
def get_renderer(room):
    return BulletRenderer(room.instance)


def render_camera(room, camera, width, height, trail=()):
    return get_renderer(room).render(room.state, camera, width, height, trail=trail)


def count_like(picture, colour, within=30):
    """Pixels whose colour is near one of the palette's."""
    wanted = 255 * np.array(palette.to_rgb(colour))
    return int((np.abs(picture - wanted).max(axis=2) <= within).sum())


def count_blue(picture):
    """Pixels of the robot's body, lit or shaded."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return int(((blue > 60) & (blue > 1.5 * green) & (blue > 2 * red)).sum())


@pytest.mark.nightly_for("puddle-world", 
    "many-obstacles", "noisy", "light-box", "four-rooms", "dead-ends", "multi-room", "lights-out", "smallest",
    "potions", "foraging", "paper-one-button", "clutter", "sokoban")
@pytest.mark.parametrize("name", thin([*PRESETS, *EXTREMES], 3))
def test_every_camera_pictures_every_room(name):
    room = make_room(name, seed=1)
    for camera in CAMERAS:
        picture = render_camera(room, camera, 97, 64)
        assert picture.shape == (64, 97, 3) and picture.dtype == np.uint8
        if camera == "robot":  # which may begin before a wall, and turns round
            for quarter in range(1, 4):
                state = room.state._replace(heading_steps=quarter * room.rules.headings // 4)
                room.set_state(state)
                picture = np.concatenate([picture, render_camera(room, camera, 97, 64)])
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
    assert count_blue(render_camera(room, "chase", 97, 64)) > 60
    room.close()


@pytest.mark.nightly
def test_puddles_lie_on_the_floor():
    """They cover 71 of the 441 m^2 of floor; the picture shows walls besides."""
    room = make_room("puddle-world")
    picture = render_camera(room, "overhead", 300, 300)
    floor = np.sum(np.abs(picture.astype(int) - picture[0, 0]).max(axis=2) > 3)
    assert 0.09 < count_like(picture, palette.PUDDLE, 12) / floor < 0.16
    room.close()


@pytest.mark.nightly
def test_the_same_state_gives_the_same_picture_in_any_room_and_process():
    script = """
import hashlib, sys
from hrl_escape.env.engine import CAMERAS, film, make_engine
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.presets import get_preset
room = make_engine(generate(get_preset("clutter"), 3))
states = [room.state] + [room.step(action).state for action in (0, 4, 0, 2)]
digest = hashlib.sha256()
for camera in CAMERAS:
    for frame in film(room.instance, states, camera, 120, 90):
        digest.update(frame.tobytes())
print(digest.hexdigest())
"""
    there = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True,
                           env=os.environ | {"PYTHONHASHSEED": "1"}).stdout
    room = make_room("clutter")
    states = [room.state] + [room.step(action).state for action in (0, 4, 0, 2)]
    digest = hashlib.sha256()
    other = make_room("clutter")
    for camera in CAMERAS:
        for number, state in enumerate(states, start=1):  # another room, which has been elsewhere before
            other.step(1)
            render_camera(other, camera, 50, 50)
            other.set_state(state)
            trail = [(s.x, s.y) for s in states[:number]]
            digest.update(render_camera(other, camera, 120, 90, trail=trail).tobytes())
    assert digest.hexdigest() == there.strip()


@pytest.mark.nightly_for("push-block", "clutter")
@pytest.mark.parametrize("name", ["clutter", "push-block", "door"])
def test_taking_pictures_changes_nothing(name):
    watched, unwatched = make_room(name), make_room(name)
    for action in np.random.default_rng(0).integers(6, size=12).tolist():
        for camera in CAMERAS:
            render_camera(watched, camera, 40, 30)
        assert watched.step(action) == unwatched.step(action)
    watched.close()
    unwatched.close()


def test_overhead_shows_positions_true_to_scale():
    room = make_room("paper-one-button")

    def find_robot(x, y):
        room.set_state(room.state._replace(x=x, y=y))
        picture = render_camera(room, "overhead", 200, 200)
        red, green, blue = (picture[..., i].astype(int) for i in range(3))
        rows, columns = np.nonzero((blue > 60) & (blue > 1.5 * green) & (blue > 2 * red))
        return np.array([columns.mean(), -rows.mean()])

    centre, east, north = find_robot(0, 0), find_robot(6, 0), find_robot(0, 6)
    assert abs(east[1] - centre[1]) < 1 and abs(north[0] - centre[0]) < 1
    assert east[0] - centre[0] == pytest.approx(north[1] - centre[1], abs=1)
    assert 40 < east[0] - centre[0] < 60  # 20 m and the walls fill 200 pixels
    assert find_robot(-6, -3) == pytest.approx(centre - (east - centre) - (north - centre) / 2, abs=1)


def test_buttons_light_up_and_the_exit_turns_green():
    room = make_room("paper-two-button")
    pictures = []
    for puzzle in (0b00, 0b01, 0b11):
        room.set_state(room.state._replace(puzzle=puzzle))
        pictures.append(render_camera(room, "overhead", 160, 120))
    lit = [count_like(picture, palette.LIT.fill) for picture in pictures]
    off = [count_like(picture, palette.OFF.fill) for picture in pictures]
    assert lit[0] == 0 and lit[1] > 100 and lit[2] > 1.7 * lit[1]
    assert off[0] > 1.7 * off[1] > 0 and off[2] == 0
    glow = [count_like(picture, palette.LOOKS["lit mat"], 12) for picture in pictures]  # on the floor before them
    assert glow[0] == 0 and glow[2] > 1.5 * glow[1] > 0
    green = [int((p[..., 1].astype(int) - np.maximum(p[..., 0], p[..., 2]) > 40).sum()) for p in pictures]
    assert green[0] == green[1] == 0 and green[2] > 300
    room.set_state(room.state._replace(puzzle=0))  # and out again
    assert np.array_equal(render_camera(room, "overhead", 160, 120), pictures[0])


def test_pixels_do_not_show_which_buttons_wait_for_others():
    pictures = []
    for edges in ((), ((0, 1),)):
        config = get_preset("paper-two-button").to_dict()
        config["puzzle"]["graph"] = {"kind": "edges", "edges": edges}
        config["puzzle"]["goal"] = 1
        room = BulletRoom(generate(RoomConfig.from_dict(config), 0))
        room.set_state(room.state._replace(heading_steps=18))  # towards button 2
        pictures.append(render_camera(room, "robot", 84, 84))
        assert count_like(pictures[-1], palette.OFF.fill) > 500
    assert np.array_equal(*pictures)


def test_the_trail_lies_on_the_floor_where_the_robot_went():
    room = make_room("paper-one-button")
    trail = [(-4.0, -4.0), (4.0, -4.0), (4.0, 0.0)]
    plain = render_camera(room, "overhead", 200, 200)
    drawn = render_camera(room, "overhead", 200, 200, trail=trail)
    rows, columns = np.nonzero((plain != drawn).any(axis=2))
    scale = (columns.max() - columns.min()) / 8.0  # 8 m wide, 4 m high
    assert (rows.max() - rows.min()) / scale == pytest.approx(4.0, abs=0.5)
    assert rows.min() > 80 and count_like(drawn, palette.TRAIL) > 50
    assert np.array_equal(render_camera(room, "overhead", 200, 200, trail=trail[:1]), plain)


def test_walls_hide_the_trail_behind_them():
    room = make_room("paper-one-button")
    room.set_state(room.state._replace(x=0.0, y=0.0, heading_steps=0))
    ahead = render_camera(room, "robot", 120, 90, trail=[(3.0, 2.0), (6.0, -2.0)])
    behind_wall = render_camera(room, "robot", 120, 90, trail=[(13.0, 2.0), (13.0, -2.0)])
    behind_eye = render_camera(room, "robot", 120, 90, trail=[(-3.0, 2.0), (-3.0, -2.0)])
    plain = render_camera(room, "robot", 120, 90)
    assert not np.array_equal(ahead, plain)
    assert np.array_equal(behind_wall, plain) and np.array_equal(behind_eye, plain)


@pytest.mark.nightly_for("sixteen-rooms", "many-obstacles", "clutter")
@pytest.mark.parametrize("name", ["clutter", "sixteen-rooms", "door", "many-obstacles"])
def test_the_chase_camera_sees_the_robot_wherever_it_is(name):
    room = make_room(name)
    rng = np.random.default_rng(1)
    hidden = 0
    for _ in range(25):
        for action in rng.choice([0, 0, 0, 1, 2, 3, 4, 5], size=8).tolist():
            room.step(int(action))
        room.set_state(room.state._replace(heading_steps=int(rng.integers(36)), primitives=0))
        hidden += count_blue(render_camera(room, "chase", 80, 60)) < 40
    assert hidden == 0


@pytest.mark.nightly
def test_without_cutting_walls_the_chase_camera_would_not_see_it(monkeypatch):
    monkeypatch.setattr(bullet_cameras, "_hides", lambda *_: False)
    with pytest.raises(AssertionError):
        test_the_chase_camera_sees_the_robot_wherever_it_is("sixteen-rooms")


def test_arms_blocks_and_doors_are_seen_to_move():
    arm = make_room("arm-two-button")
    before = render_camera(arm, "chase", 120, 90)
    arm.step(6)
    assert not np.array_equal(render_camera(arm, "chase", 120, 90), before)
    door = make_room("clutter")
    assert door.instance.door is not None
    x, y = door.instance.door.x, door.instance.door.y
    inside = 2.0 * np.sign(0 - np.array([x, y])) * (np.abs([x, y]) > door.instance.half_width)
    shut, opened = (door.state._replace(x=x + inside[0], y=y + inside[1], puzzle=puzzle) for puzzle in (0, 0b1111))
    frames = list(film(door.instance, [shut, opened], "overhead", 160, 120, trail=False))
    assert count_like(frames[0], palette.DOOR, 40) > 2 * count_like(frames[1], palette.DOOR, 40)


@pytest.mark.nightly_for("franka-panda")
@pytest.mark.parametrize("kind", ["kuka-iiwa", "franka-panda"])
def test_named_arms_are_shown_with_their_joints(kind):
    config = RoomConfig(room=ShapeConfig(width=10, depth=10), robot=RobotConfig(kind=kind, joints=7, body_radius=0.4))
    room = BulletRoom(generate(config, 0))
    before = render_camera(room, "chase", 120, 90)
    for joint in (1, 3):  # they swing whole parts of the arm
        was = room.state.joint_steps
        up, down = make_action_table(joints=7).joints[joint]
        if room.step(up).state.joint_steps == was:  # at its limit
            room.step(down)
        after = render_camera(room, "chase", 120, 90)
        assert (before != after).any(axis=2).sum() > 10
        before = after


def test_pushed_blocks_are_seen_where_they_are():
    room = make_room("push-block")
    place = room.instance.props[0]
    room.set_state(room.state._replace(x=place.x - 1.5, y=place.y, heading_steps=0))

    def find_block():
        picture = render_camera(room, "overhead", 240, 240)
        wanted = 255 * np.array(palette.to_rgb(palette.PROP))
        rows, columns = np.nonzero(np.abs(picture - wanted).max(axis=2) < 25)
        return columns.mean(), rows.mean()

    before = find_block()
    for _ in range(3):
        room.step(0)
    after = find_block()
    assert after[0] > before[0] + 10 and abs(after[1] - before[1]) < 10


@pytest.mark.nightly
def test_pictures_free_what_they_needed():
    room = make_room("paper-one-button")
    renderer = BulletRenderer(room.instance)
    renderer.render(room.state, "chase", 40, 30)
    stage = renderer._stage.client
    assert pybullet.isConnected(stage)
    del renderer
    gc.collect()
    assert not pybullet.isConnected(stage)


def test_clear_errors(monkeypatch):
    room = make_room("paper-one-button")
    with pytest.raises(UnknownNameError, match="'chase'"):
        render_camera(room, "chasse", 40, 30)
    for size in ((7, 30), (30, 2049)):
        with pytest.raises(ConfigError, match="8 to 2048"):
            render_camera(room, "chase", *size)
    env = gymnasium.make("hrl_escape/PaperOneButton-v1", render_mode="rgb_array").unwrapped
    env.close()
    with pytest.raises(ClosedError):
        env.render()
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(UnsupportedError, match="display"):
        gymnasium.make("hrl_escape/PaperOneButton-v1", render_mode="human")


def test_the_environment_gives_frames_with_a_trail():
    env = gymnasium.make("hrl_escape/Clutter-v1", render_mode="rgb_array", camera="overhead", render_size=(160, 120),
                         trail=True)
    env.reset(seed=0)
    first = env.render()
    for _ in range(3):
        env.step(0)
    second = env.render()
    assert first.shape == second.shape == (120, 160, 3)
    assert count_like(second, palette.TRAIL) > count_like(first, palette.TRAIL)
    env.close()


# --- soft edges ----------------------------------------------------------------------------


def make_edge(angle, samples):
    """A half-plane of dark on bright, 64 x 64, sampled samples x samples times a pixel."""
    at = (np.arange(64 * samples) + 0.5) / samples - 32
    dark = np.cos(angle) * at[None, :] + np.sin(angle) * at[:, None] > 0.3
    share = dark.reshape(64, samples, 64, samples).mean(axis=(1, 3))
    grey = (230 - 180 * share + 0.5).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


@pytest.mark.parametrize("degrees", [3, 10, 30, 45, 60, 80, 88, 100, 170])
def test_softened_edges_are_nearer_to_the_exact_coverage(degrees):
    angle = np.radians(degrees)
    exact, hard = make_edge(angle, 16).astype(float), make_edge(angle, 1)
    soft = soften_edges(hard)
    inner = np.s_[16:48, 16:48]  # the search for an edge's end stops at the picture's border
    before, after = (np.abs(picture.astype(float) - exact)[inner].mean() for picture in (hard, soft))
    assert after < 0.75 * before


def test_plain_areas_stay_and_straight_edges_stay_sharp():
    flat = np.full((20, 30, 3), 77, dtype=np.uint8)
    assert np.array_equal(soften_edges(flat), flat)
    half = flat.copy()
    half[:, 15:] = 200
    assert np.abs(soften_edges(half).astype(int) - half).max() < 0.1 * (200 - 77)
