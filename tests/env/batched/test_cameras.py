"""Cameras of a batch beside Bullet's renderer: what each pixel sees, how far away, and how it is had."""

import gymnasium
import numpy as np
import pybullet
import pytest
import torch

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.env.batched.cameras import LABELS, LABELS_OF_LOOKS, BatchedCamera
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.bullet import cameras as bullet_cameras
from hrl_escape.env.bullet.cameras import BulletRenderer
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import RobotConfig, RoomConfig
from hrl_escape.env.sampling.generation import generate
from tests.env.rooms import all_configs

WIDTH, HEIGHT = 72, 54
ALSO = {"paper-two-button": {"floor", "exit", "robot"}, "clutter": {"floor", "obstacle", "door", "target"},
        "door-key": {"floor", "door"}, "sokoban": {"block", "exit"}}


def label_bodies(stage):
    """Label of each body of Bullet's scenery; paint that is no exit is floor."""
    roles = {body: role.replace(" edge", "").replace(" top", "") for body, role in stage.roles.items()}
    return {body: "robot" if role in ("trim", "arm") else LABELS_OF_LOOKS.get(role, "floor")
            for body, role in roles.items()}


def look_with_bullet(room, camera):
    """Depth and labels of Bullet's picture of a room."""
    renderer = BulletRenderer(room.instance)
    renderer.render(room.state, camera, WIDTH, HEIGHT)
    stage = renderer._stage
    view = bullet_cameras._VIEWS[camera](stage.model.rules, room.state, WIDTH / HEIGHT)
    matrices = (pybullet.computeViewMatrix(view.eye, view.target, view.up),
                pybullet.computeProjectionMatrixFOV(view.field, WIDTH / HEIGHT, view.near, view.far))
    *_, depths, bodies = pybullet.getCameraImage(WIDTH, HEIGHT, *matrices, renderer=pybullet.ER_TINY_RENDERER,
                                                 physicsClientId=stage.client)
    depth = view.near * view.far / (view.far - np.reshape(depths, (HEIGHT, WIDTH)) * (view.far - view.near))
    names = label_bodies(stage)
    seen = np.reshape(bodies, (HEIGHT, WIDTH))
    return depth, np.vectorize(lambda body: LABELS.index(names[body]) if body >= 0 else 0)(seen)


def list_neighbours(picture):
    """A picture shifted by up to one pixel in every direction, (9, height, width)."""
    padded = np.pad(picture, 1, mode="edge")
    return np.stack([padded[i : i + HEIGHT, j : j + WIDTH] for i in range(3) for j in range(3)])


@pytest.mark.nightly_for("clutter", "sokoban", "paper-two-button")
@pytest.mark.parametrize("name", ["paper-two-button", "clutter", "door-key", "sokoban"])
def test_depth_and_labels_are_those_of_bullets_cameras(name):
    instance = generate(all_configs()[name], 1)
    batch = TensorRoom(Rooms(3, instance=instance))
    batch.reset(torch.arange(3))
    generator = torch.Generator().manual_seed(0)
    for _ in range(25):
        batch.step(torch.randint(batch.actions, (3,), generator=generator))
    bullet, seen_labels = BulletRoom(instance), set()
    for camera in ("robot", "overhead"):
        pictures = BatchedCamera(batch, camera, WIDTH, HEIGHT).take()
        for room in range(3 if camera == "robot" else 1):
            bullet.set_state(batch.get_room_state(room))
            depth, labels = look_with_bullet(bullet, camera)
            ours = pictures.segmentation[room].numpy()
            near = list_neighbours(ours)
            assert (near != labels).all(axis=0).mean() < 0.01, "a mat before a panel covers the exit"
            inside = (near == labels).all(axis=0) & (labels > 0)
            seen_labels |= set(np.unique(labels[(near == labels).any(axis=0)]).tolist())
            around, there = list_neighbours(pictures.depth[room].numpy())[:, inside], depth[inside]
            assert inside.mean() > 0.2
            # Bullet's paint lies up to 3 cm above the floor, and its cylinders have 32 sides
            agrees = (there > 0.96 * around.min(axis=0)) & (there < 1.01 * around.max(axis=0) + 0.01)
            assert agrees.mean() > 0.995
    assert {LABELS[number] for number in seen_labels} >= {"wall"} | ALSO[name]


def make_vec(count=2, **arguments):
    return gymnasium.make_vec("hrl_escape/PaperTwoButton-v1", num_envs=count, **arguments)


def test_frames_are_had_as_gymnasium_has_them_and_show_each_room_as_it_is():
    env = make_vec(render_mode="rgb_array", render_size=(40, 30))
    env.reset(seed=0)
    before = env.render()
    assert len(before) == 2 and before[0].shape == (30, 40, 3) and before[0].dtype == np.uint8
    env.step(np.array([0, 4]))  # one drives, the other turns
    drives, turns = env.render()
    assert (drives != before[0]).any() and (drives != turns).any()
    assert make_vec().render() is None


def test_what_is_pressed_lights_up_and_the_open_exit_changes_its_colour():
    env = make_vec(1, output="torch").unwrapped
    env.reset(seed=0)
    dark = env.take_pictures("overhead", 64, 48)
    env.room.set_room_state(0, env.room.get_room_state(0)._replace(puzzle=0b11))
    lit = env.take_pictures("overhead", 64, 48)
    assert torch.equal(dark.segmentation, lit.segmentation) and torch.equal(dark.depth, lit.depth)
    changed = (dark.rgb != lit.rgb).any(dim=3)
    for name in ("target", "exit"):
        assert changed[lit.segmentation == LABELS.index(name)].float().mean() > 0.5
    assert not changed[lit.segmentation == LABELS.index("wall")].any()


def test_distance_to_a_wall_is_exact():
    env = make_vec(1, output="torch").unwrapped
    env.reset(seed=0)
    state, room = env.room.get_room_state(0), env.instances[0]
    env.room.set_room_state(0, state._replace(x=0.0, y=0.0, heading_steps=0))
    seen = env.take_pictures("robot", 21, 21)
    middle = seen.depth[0, :, 10][seen.segmentation[0, :, 10] == LABELS.index("wall")]
    ahead = room.half_width - 0.9 * room.robot.body_radius
    rows = torch.arange(21)[seen.segmentation[0, :, 10] == LABELS.index("wall")]
    upwards = np.tan(np.radians(35)) * (1 - 2 * (rows + 0.5) / 21)
    along = np.cos(np.radians(12)) + upwards * np.sin(np.radians(12))  # of a ray's way, on the floor
    assert len(rows) > 2 and middle.numpy() == pytest.approx((ahead / along).numpy(), rel=1e-5)


def test_a_rectangular_base_is_seen_as_one():
    config = RoomConfig(robot=RobotConfig(footprint="rectangle", body_length=3.0, body_width=1.0))
    batch = TensorRoom(Rooms(instance=generate(config, 0)))
    batch.reset(torch.arange(1))
    batch.set_room_state(0, batch.get_room_state(0)._replace(x=0.0, y=0.0, heading_steps=0))
    seen = BatchedCamera(batch, "overhead", 200, 200).take().segmentation[0] == LABELS.index("robot")
    rows, columns = seen.any(dim=1).sum().item(), seen.any(dim=0).sum().item()
    assert columns == pytest.approx(3 * rows, abs=4) and rows > 5


def test_a_room_looks_the_same_in_any_batch():
    instances = [generate(all_configs()["clutter"], seed) for seed in (0, 1)]
    many, one = TensorRoom(Rooms(4, instance=instances)), TensorRoom(Rooms(instance=instances[1:]))
    many.reset(torch.arange(4))
    one.reset(torch.arange(1))
    one.set_room_state(0, many.get_room_state(3))
    for whole, alone in zip(BatchedCamera(many, "robot", 24, 18).take(), BatchedCamera(one, "robot", 24, 18).take(),
                            strict=True):
        assert (whole[3] != alone[0]).float().mean() < 0.01
