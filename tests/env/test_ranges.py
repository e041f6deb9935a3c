"""Ranges in a room configuration: each instance draws its numbers, and all of them share one space and one scale."""

import json
import math
import pickle

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape.cli import main
from hrl_escape.env.config import (
    Between,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.observations.base import list_observations
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.options_env import OptionsEnv

VARIED = RoomConfig(
    room=ShapeConfig(width=Between(12, 18), depth=Between(12, 18), rooms=Between(1, 3)),
    robot=RobotConfig(body_radius=0.5), puzzle=ButtonsConfig(count=Between(2, 5), buttons=Panels(width=1.5)),
    obstacles=ObstaclesConfig(count=Between(0, 6)), exit=ExitConfig(door=True, width=2.5, depth=1.5),
)
VECTORS = [observation.name for observation in list_observations() if observation.is_vector]


@pytest.fixture(scope="module")
def rooms() -> list[RoomInstance]:
    return [generate(VARIED, seed) for seed in range(8)]


@pytest.mark.nightly
def test_instances_differ_within_the_ranges_and_each_seed_gives_one_room(rooms):
    assert {len(room.targets) for room in rooms} == {2, 3, 4, 5}
    assert len({room.half_width for room in rooms}) == len(rooms)
    assert all(6 <= room.half_width <= 9 and 6 <= room.half_depth <= 9 for room in rooms)
    assert generate(VARIED, 3).id == rooms[3].id


def test_a_zero_below_zero_is_plain_zero():
    """numpy draws from -0.0 to 0.0, and refuses 0.0 to -0.0 in words of its own."""
    panels, plain = Panels(height_spread=-0.0), Panels(height_spread=0.0)
    assert math.copysign(1, panels.height_spread) == 1 and json.dumps(panels.to_dict()) == json.dumps(plain.to_dict())
    rooms = [generate(RoomConfig(puzzle=ButtonsConfig(count=1, buttons=each)), 0) for each in (panels, plain)]
    assert rooms[0].id == rooms[1].id


def test_a_room_configuration_with_ranges_survives_json_and_pickling():
    assert RoomConfig.from_dict(json.loads(json.dumps(VARIED.to_dict()))) == VARIED
    assert pickle.loads(pickle.dumps(VARIED)) == VARIED
    assert VARIED.to_dict()["puzzle"]["count"] == "2..5" and VARIED.to_dict()["room"]["width"] == "12.0..18.0"


@pytest.mark.nightly
def test_an_instance_with_a_frame_survives_its_file(rooms, tmp_path):
    rooms[0].save(tmp_path / "room.json")
    assert RoomInstance.load(tmp_path / "room.json") == rooms[0]


def test_the_command_line_takes_ranges(capsys):
    counts = set()
    for seed in range(6):
        assert main(["room", "--room", f"four-button-chain#{seed}", "--set", "puzzle.count=3..5",
                     "room.width=14..20", "--json"]) == 0
        counts.add(len(json.loads(capsys.readouterr().out)["targets"]))
    assert counts == {3, 4, 5}


@pytest.mark.parametrize(("make", "word"), [
    (lambda: ButtonsConfig(count=Between(5, 3)), "count"),
    (lambda: ButtonsConfig(count=Between(0, 3)), "from 1 to 64"),
    (lambda: ButtonsConfig(count=Between(1.5, 3)), "whole number"),
    (lambda: ButtonsConfig(count="3.."), "count"),
    (lambda: RobotConfig(joints=Between(0, 2)), "robot.joints"),
    (lambda: ObstaclesConfig(size_min=Between(0.5, 3), size_max=Between(2, 4)), "size_min"),
    (lambda: RoomConfig(room=ShapeConfig(rooms=Between(1, 2), doorway_width=Between(1, 3))), "doorway_width"),
    (lambda: RoomConfig(room=ShapeConfig(*[Between(10, 20)] * 2, *[Between(1, 2)] * 3, Between(2, 3)),
                        start=StartConfig(x=Between(0, 1), y=Between(0, 1)),
                        exit=ExitConfig(x=Between(0, 1))), "at most 8 ranges"),
])
def test_an_impossible_range_is_refused(make, word):
    with pytest.raises(ConfigError, match=word):
        make()


@pytest.mark.nightly_for("egocentric", "features")
@pytest.mark.parametrize("observation", VECTORS)
def test_every_instance_has_the_same_spaces_in_both_engines(rooms, observation):
    batched = EscapeRoomVectorEnv(len(rooms), instance=rooms, observation=observation)
    for room in rooms:
        single = EscapeRoomEnv(instance=room, observation=observation)
        assert single.observation_space == batched.single_observation_space
        assert single.action_space == batched.single_action_space
        single.close()


@pytest.mark.nightly_for("clutter")
@pytest.mark.parametrize("name", ["clutter", "door"])
def test_a_door_in_another_wall_changes_no_space(name):
    config = get_preset("clutter") if name == "clutter" else RoomConfig(exit=ExitConfig(door=True, width=2.4))
    env = EscapeRoomEnv(config, observation="state", resample_instance=True)
    space = env.observation_space
    for seed in range(6):
        env.reset(seed=seed)
        assert env.observation_space == space
    env.close()


@pytest.mark.nightly_for("egocentric", "objects", "features")
@pytest.mark.parametrize("observation", VECTORS)
def test_rooms_of_different_sizes_step_alike_in_both_engines(rooms, observation):
    batched = EscapeRoomVectorEnv(len(rooms), instance=rooms, observation=observation)
    singles = [EscapeRoomEnv(instance=room, observation=observation) for room in rooms]
    rng = np.random.default_rng(0)
    seen, infos = batched.reset(seed=0)
    assert np.allclose(seen, [single.reset(seed=i)[0] for i, single in enumerate(singles)], atol=1e-5)
    for _ in range(60):
        actions = rng.integers(batched.single_action_space.n, size=len(rooms))
        seen, _, _, _, infos = batched.step(actions)
        steps = [single.step(int(action)) for single, action in zip(singles, actions, strict=True)]
        assert np.allclose(seen, [step[0] for step in steps], atol=1e-5)
        assert np.array_equal(infos["buttons_on"], [step[4]["buttons_on"] for step in steps])
    for single in singles:
        single.close()


def test_numbers_of_absent_buttons_are_nought(rooms):
    room = min(rooms, key=lambda room: len(room.targets))
    env = EscapeRoomEnv(instance=room, observation="egocentric")
    absent = env.reset(seed=0)[0][4 * len(room.targets) : 20]
    assert len(absent) == 12 and not absent.any()
    assert env.step(0)[4]["buttons_on"].shape == (5,)
    env.close()


def test_synchronous_vectors_take_rooms_of_different_sizes():
    env = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=4, vectorization_mode="sync", config=VARIED,
                             resample_instance=True, observation="features")
    env.reset(seed=0)
    env.close()


@pytest.mark.nightly
def test_options_of_absent_buttons_are_masked_and_cost_one_primitive(rooms):
    rooms = sorted(rooms, key=lambda room: len(room.targets))[::4]
    batched = BatchedOptionsEnv(len(rooms), instance=rooms, include_primitives=False)
    batched.reset(torch.arange(len(rooms)))
    for number, room in enumerate(rooms):
        env = OptionsEnv(EscapeRoomEnv(instance=room), include_primitives=False)
        mask = env.reset(seed=number)[1]["action_mask"]
        assert env.action_names == batched.action_names == (*(f"press-button-{n}" for n in range(1, 6)), "go-to-exit")
        assert mask.tolist() == [1] * len(room.targets) + [0] * (6 - len(room.targets))
        assert np.array_equal(batched.action_mask[number].numpy(), mask)
        if len(room.targets) < 5:
            info = env.step(4)[4]
            assert (info["option"]["ended"], info["duration"]) == ("planning-failed", 1)
        env.close()


@pytest.mark.nightly
def test_options_go_on_when_the_next_room_has_another_number_of_buttons():
    env = OptionsEnv(EscapeRoomEnv(VARIED, resample_instance=True), include_primitives=False)
    counts = set()
    for seed in range(6):
        env.reset(seed=seed)
        counts.add(len(env.unwrapped.instance.targets))
        assert env.step(0)[4]["option"]["ended"] == "reached"
    assert len(counts) > 1
    env.close()


@pytest.mark.nightly
def test_batched_random_options_escape_from_rooms_of_different_sizes(rooms):
    rooms = sorted(rooms, key=lambda room: len(room.targets))[::4]
    env = BatchedOptionsEnv(len(rooms), instance=rooms, include_primitives=False)
    env.reset(torch.arange(len(rooms)))
    generator = torch.Generator().manual_seed(0)
    escaped = torch.zeros(len(rooms), dtype=torch.bool)
    for _ in range(1000):
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=generator).squeeze(1))
        escaped |= done.where & done.terminated
        if escaped.all():
            break
    assert escaped.all()


@pytest.mark.nightly
@pytest.mark.nightly_for("8")
@pytest.mark.parametrize("most", [4, 8])
def test_paper_random_gives_every_seed_a_room_of_its_own(most):
    rooms = [generate(get_preset("paper-random", most=most), seed) for seed in range(40)]
    assert {len(room.targets) for room in rooms} == set(range(1, most + 1))
    assert len({(target.x, target.y, target.half_x) for room in rooms for target in room.targets}) == sum(
        len(room.targets) for room in rooms)
    assert len({room.puzzle.edges for room in rooms}) > most
    assert len({room.puzzle.goal_targets for room in rooms}) >= most - 2
    assert len({room.exit for room in rooms}) == len({room.starts for room in rooms}) == 40
