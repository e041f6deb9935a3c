"""Instances: pure, certified, stable in JSON and hash, and refused with one clear error."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.config import ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling import generation
from hrl_escape.env.sampling.generation import KEPT_ROOMS, generate
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import ConfigError, EscapeError, GenerationError, InstanceFileError, UnknownNameError
from tests.covering import thin
from tests.env.rooms import EXTREMES, all_configs
from tests.forks import run_fork

NAMES = sorted(all_configs())
QUICK = [name for name in NAMES if name not in ("largest", "four-rooms")]
"""Without those that take seconds a sample; they have tests of their own."""


@pytest.mark.nightly_for("5")
@pytest.mark.parametrize("examples", [5, pytest.param(40, marks=pytest.mark.nightly)])
def test_generation_is_pure_and_certified(examples):
    @settings(max_examples=examples)
    @given(st.sampled_from(QUICK), st.integers(0, 10_000))
    def check(name, seed):
        config = all_configs()[name]
        instance = generate(config, seed)
        generation._sample_room.cache_clear()
        assert generate(config, seed) == instance
        assert find_unmet_constraint(instance) is None
        assert len(instance.targets) == len(instance.puzzle.target_names)
        assert sum(s.role == "obstacle" for s in instance.solids) == config.obstacles.count
        assert config.start.place == "cells" or len(instance.starts) == config.start.choices

    check()


@pytest.mark.nightly
def test_a_room_asked_for_again_is_the_same_object_until_many_others_were(nothing_kept):
    config = get_preset("four-button-chain")
    first = generate(config, 0)
    assert generate(dataclasses.replace(config), 0) is first
    assert generate(dataclasses.replace(config, horizon=7), 0) is not first
    for seed in range(1, KEPT_ROOMS + 1):
        assert generate(config, seed).seed == seed
    again = generate(config, 0)
    assert again is not first and again == first


@dataclasses.dataclass(frozen=True)
class WithTable(ButtonsConfig):
    table: dict[str, int] = dataclasses.field(default_factory=dict)


def test_settings_that_hold_a_table_make_rooms_too():
    plain, tabled = (RoomConfig(puzzle=puzzle) for puzzle in (ButtonsConfig(), WithTable(table={"a": 1})))
    assert generate(tabled, 3).targets == generate(plain, 3).targets


@pytest.mark.nightly
def test_the_largest_room_is_generated():
    instance = generate(EXTREMES["largest"], 0)
    assert sum(s.role == "obstacle" for s in instance.solids) == 200
    assert find_unmet_constraint(instance) is None


def flood(instance, resolution):
    """Floor the body can reach, found by walking the real kinematics in short straight moves."""
    body = dataclasses.replace(instance.robot, move_step=resolution)
    walker = Kinematics(dataclasses.replace(instance, robot=body))
    start = instance.starts[0]
    seen = {(0, 0)}
    queue = [(0, 0)]
    unsolved = instance.puzzle.make_state()
    while queue:
        i, j = queue.pop()
        x, y = start.x + i * resolution, start.y + j * resolution
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            cell = (i + di, j + dj)
            if cell not in seen and walker.compute_free_fraction(x, y, di * resolution, dj * resolution, unsolved) == 1:
                seen.add(cell)
                queue.append(cell)
    return [(start.x + i * resolution, start.y + j * resolution) for i, j in seen]


@pytest.mark.nightly_for(
    "clutter-2", "door-0", "clutter-1", "door-2", "door-1", "clutter-3", "four-button-chain-3", "four-button-chain-2",
    "four-button-chain-1")
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["clutter", "four-button-chain", "door"])
def test_walking_the_floor_reaches_every_button_and_the_exit(name, seed):
    instance = generate(all_configs()[name], seed)
    floor = flood(instance, 0.25)
    reach = instance.robot.body_radius + instance.dynamics.press_margin
    for target in instance.targets:
        assert min(compute_distance(x, y, target.footprint) for x, y in floor) <= reach + 0.25
    doorstep = instance.door or instance.exit
    if instance.door:
        assert not any(instance.exit.contains(x, y) for x, y in floor)  # shut until the puzzle is solved
        assert min(np.hypot(x - doorstep.x, y - doorstep.y) for x, y in floor) < 2
    else:
        assert any(instance.exit.contains(x, y) for x, y in floor)


def test_the_certificate_notices_a_walled_off_button():
    instance = generate(get_preset("four-button-chain"), 0)
    target = instance.targets[2]
    cage = Solid("box", target.x, target.y, 1.6, 1.6, target.yaw, 1.0, "obstacle")
    assert find_unmet_constraint(dataclasses.replace(instance, solids=(*instance.solids, cage))) is not None


@pytest.mark.nightly
def test_seeds_give_different_rooms():
    assert len({generate(get_preset("clutter"), seed).id for seed in range(8)}) == 8


@pytest.mark.parametrize("name", thin(QUICK, 6))
def test_json_round_trip_keeps_everything(name, tmp_path):
    instance = generate(all_configs()[name], 3)
    instance.save(tmp_path / "room.json")
    loaded = RoomInstance.load(tmp_path / "room.json")
    assert loaded == instance
    assert loaded.id == instance.id
    assert json.dumps(loaded.to_dict()) == json.dumps(instance.to_dict())


def test_id_is_a_hash_of_the_content_alone():
    instance = generate(get_preset("clutter"), 1)
    assert dataclasses.replace(instance, name="other", seed=None).id == instance.id
    assert dataclasses.replace(instance, horizon=999).id != instance.id
    content = {k: v for k, v in instance.to_dict().items() if k not in ("name", "seed")}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    assert instance.id == hashlib.sha256(text.encode()).hexdigest()[:16]


@pytest.mark.nightly
def test_another_process_generates_the_same_instances():
    code = (
        "from hrl_escape.env.sampling.generation import generate; from hrl_escape.env.presets import *\n"
        "print(*[generate(get_preset(n), 5).id for n in sorted(PRESETS)[::4]])"
    )
    printed = run_fork(code, check=True).stdout.split()
    assert printed == [generate(get_preset(name), 5).id for name in sorted(PRESETS)[::4]]


@pytest.mark.nightly
def test_impossible_room_configurations_say_which_constraint_failed():
    with pytest.raises(GenerationError, match="obstacles"):
        generate(RoomConfig(room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.7),
                            obstacles=ObstaclesConfig(count=50, size_min=1)), 0)
    with pytest.raises(GenerationError, match="must fit onto a wall"):
        generate(RoomConfig(puzzle=ButtonsConfig(count=1, buttons=Panels(width=30))), 0)
    with pytest.raises(GenerationError, match="rooms"):
        generate(RoomConfig(room=ShapeConfig(width=8, depth=8, rooms=16)), 0)
    with pytest.raises(GenerationError, match="hang low enough"):
        generate(RoomConfig(puzzle=ButtonsConfig(buttons=Panels(centre_height=2.5))), 0)


@pytest.mark.parametrize("seed", [-1, 1.5, "1", None, True, 2**64])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(ConfigError, match="seed"):
        generate(RoomConfig(), seed)


def test_unknown_preset_and_arguments_are_named():
    with pytest.raises(UnknownNameError, match="did you mean 'clutter'"):
        get_preset("cluter")
    with pytest.raises(ConfigError, match="larg-2019"):
        get_preset("larg-2019", handicap=6.0, colour="red")
    with pytest.raises(ConfigError, match="from 1 to 4"):
        get_preset("larg-2019", size=9)


@pytest.mark.nightly
@given(st.data())
def test_a_damaged_instance_file_gives_one_clear_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("rooms") / "room.json"
    generate(get_preset("four-button-chain"), 0).save(path)
    text = path.read_text()
    if data.draw(st.booleans(), label="truncate"):
        damaged = text[: data.draw(st.integers(0, len(text) - 3), label="length")]
    else:
        at = data.draw(st.integers(0, len(text) - 1), label="where")
        letter = data.draw(st.characters(min_codepoint=32, max_codepoint=126), label="what")
        damaged = text[:at] + letter + text[at + 1 :]
    path.write_text(damaged)
    try:
        loaded = RoomInstance.load(path)
    except EscapeError as error:
        assert str(path) in str(error)
    else:  # only what does not change the content may pass
        assert loaded.id == generate(get_preset("four-button-chain"), 0).id


def test_a_newer_schema_is_named():
    data = generate(get_preset("paper-one-button"), 0).to_dict() | {"schema": 99}
    with pytest.raises(InstanceFileError, match="schema 99.*newer hrl-escape"):
        RoomInstance.from_dict(data)


def test_a_body_too_wide_for_a_way_is_not_certified():
    instance = generate(get_preset("clutter"), 2)
    wide = dataclasses.replace(instance, robot=RobotConfig(body_radius=1.26))
    assert find_unmet_constraint(wide) is not None
