"""The batched engine through its own door: episodes, streams, states, compilation and refusals."""

import dataclasses

import numpy as np
import pytest
import torch

from hrl_escape.env.batched import compilation
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.puzzles.base import TensorContacts, as_signed, get_tensor_puzzle
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.batched.tables import map_tensors
from hrl_escape.env.config import DynamicsConfig, ObstaclesConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles import base
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import (
    ActionError,
    BatchError,
    ConfigError,
    EscapeError,
    ResetNeededError,
    StateError,
    UnsupportedError,
)

NOISY = RoomConfig(dynamics=DynamicsConfig(noise=0.1, slip=0.1), obstacles=ObstaclesConfig(count=5),
                   room=ShapeConfig(width=12, depth=12), start=StartConfig(choices=7), horizon=25)
FORWARD, LEFT = 0, 2


def make_rooms(rooms, instances=3, config=NOISY, **more):
    autoreset = more.pop("autoreset", "next-step")
    return TensorRoom(Rooms(rooms, config, num_instances=instances, **more), autoreset=autoreset)


def actions_of(seeds, steps, count):
    """Primitives that depend on a room's seed alone, (steps, rooms)."""
    return torch.from_numpy(np.stack([np.random.default_rng(s).integers(count, size=steps) for s in seeds], axis=1))


def play(room, seeds, steps=80):
    """Observations, rewards and ends of a batch, one row a room."""
    room.reset(torch.tensor(seeds))
    rows = []
    for action in actions_of(seeds, steps, room.actions):
        seen, reward, terminated, truncated, *_ = room.step(action)
        rows.append(torch.cat([seen, torch.stack([reward, terminated, truncated], dim=1)], dim=1))
    return torch.stack(rows, dim=1)


# --- episodes and streams --------------------------------------------------------------


@pytest.mark.nightly
def test_a_room_meets_the_same_fate_alone_and_in_any_batch():
    seeds = list(range(100, 112))
    together = play(make_rooms(12), seeds)
    assert together[:, :, -1].sum() >= 24  # truncations: several episodes, noise, slips and drawn starts
    order = [7, 4, 1, 10, 2, 5, 8, 11, 0, 3, 6, 9]
    other = play(make_rooms(12, instances=1), [seeds[0]] * 12)
    assert torch.equal(other[0], other[11])
    again = play(make_rooms(12), [seeds[i] for i in order])
    by_instance = {i: [k for k in range(12) if k % 3 == i] for i in range(3)}
    for place, number in enumerate(order):
        if place % 3 == number % 3:  # the same instance
            assert torch.equal(again[place], together[number])
    for number in by_instance[0]:
        assert torch.equal(play(make_rooms(1), [seeds[number]])[0], together[number])


def test_resampling_draws_every_instance_and_depends_on_the_rooms_own_seed():
    room = make_rooms(64, instances=3, resample_instance=True)
    room.reset(torch.arange(64))
    begun = room.state.instance.clone()
    assert set(begun.tolist()) == {0, 1, 2}
    room.reset()
    assert not torch.equal(room.state.instance, begun)
    alone = make_rooms(1, instances=3, resample_instance=True)
    alone.reset(torch.tensor([5]))
    alone.reset()
    assert alone.state.instance[0] == room.state.instance[5]
    assert alone.get_room_state(0) == room.get_room_state(5)


def test_starts_are_all_drawn():
    room = make_rooms(300, instances=1)
    room.reset(torch.arange(300))
    starts = {(s.x, s.y) for s in room.instances[0].starts}
    assert {(x, y) for x, y in zip(room.state.x.tolist(), room.state.y.tolist(), strict=True)} == starts


def test_each_way_of_resetting():
    instance = dataclasses.replace(generate(get_preset("paper-one-button"), 0), horizon=3)
    ends = {}
    for autoreset in ("next-step", "same-step", "disabled"):
        room = TensorRoom(Rooms(2, instance=instance), autoreset=autoreset)
        room.reset(torch.tensor([0, 1]))
        steps = [room.step(torch.tensor([LEFT, LEFT])) for _ in range(3)]
        assert [bool(s.truncated[0]) for s in steps] == [False, False, True]
        ends[autoreset] = steps[-1], room
    last, room = ends["next-step"]
    assert last.observation[0, :2].tolist() == [0.0, 3.0]
    after = room.step(torch.tensor([LEFT, LEFT]))
    assert after.observation[0, :2].tolist() == [0.0, 0.0]
    assert (after.reward[0], bool(after.truncated[0]), int(after.info.primitives[0])) == (0.0, False, 0)
    assert room.step(torch.tensor([LEFT, LEFT])).observation[0, :2].tolist() == [0.0, 1.0]
    last, room = ends["same-step"]
    assert last.observation[0, :2].tolist() == [0.0, 0.0]
    assert last.final_observation[0, :2].tolist() == [0.0, 3.0]
    assert (int(last.final_info.primitives[0]), int(last.info.primitives[0])) == (3, 0)
    last, room = ends["disabled"]
    with pytest.raises(ResetNeededError, match="autoreset is disabled"):
        room.step(torch.tensor([LEFT, LEFT]))
    room.reset(where=torch.tensor([True, False]))
    assert room.observe()[:, 1].tolist() == [0.0, 3.0]


def test_what_a_last_primitive_did_is_told_in_the_final_info_only():
    room = TensorRoom(Rooms(instance=generate(get_preset("paper-one-button"), 0)), autoreset="same-step")
    room.reset(torch.tensor([0]))
    last = [room.step(torch.tensor([LEFT])) for _ in range(9)][-1]
    assert bool(last.terminated) and last.reward.item() == 99.0
    assert [last.final_info.pressed.item(), last.final_info.buttons_on.item()] == [1, 1]
    assert [last.info.pressed.item(), last.info.buttons_on.item()] == [0, 0]
    assert room.step(torch.tensor([LEFT])).info.primitives.item() == 1


def test_reset_with_seeds_and_a_mask_reseeds_only_those_rooms():
    room = make_rooms(4)
    room.reset(torch.arange(4))
    before = [room.get_room_state(i) for i in range(4)]
    room.reset(torch.tensor([9, 9, 9, 9]), torch.tensor([False, True, False, False]))
    after = [room.get_room_state(i) for i in range(4)]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True, True]
    assert room.state.seed.tolist() == [0, 9, 2, 3]


# --- states ----------------------------------------------------------------------------


@pytest.mark.nightly
def test_states_go_out_and_back_and_go_on_exactly():
    room = make_rooms(6)
    room.reset(torch.arange(6))
    acts = actions_of(range(6), 40, room.actions)
    for action in acts[:15]:
        room.step(action)
    kept, states = room.state, [room.get_room_state(i) for i in range(6)]
    assert room.get_room_states([4, 1, 5]) == [states[4], states[1], states[5]] and len(set(states)) == 6
    first = [room.step(action).observation for action in acts[15:]]
    room.state = kept
    assert all(torch.equal(a, room.step(b).observation) for a, b in zip(first, acts[15:], strict=True))
    other = make_rooms(6)
    other.reset(torch.arange(6) + 50)
    for number, state in enumerate(states):
        other.set_room_state(number, state)
        assert other.get_room_state(number) == state
    for action in acts[15:23]:
        other.step(action)
    room.state = kept
    for action in acts[15:23]:
        room.step(action)
    assert [other.get_room_state(i) for i in range(6)] == [room.get_room_state(i) for i in range(6)]


@pytest.mark.nightly_for("joints")
@pytest.mark.parametrize("config", [NOISY, get_preset("arm-two-button")], ids=["no joints", "joints"])
def test_states_of_some_rooms_are_those_of_batches_of_one(config):
    room = make_rooms(5, config=config)
    room.reset(torch.arange(5))
    singles = [TensorRoom(Rooms(instance=room.instances[i % 3])) for i in range(5)]
    for seed, single in enumerate(singles):
        single.reset(torch.tensor([seed]))
    for action in actions_of(range(5), 20, room.actions):
        room.step(action)
        for single, own in zip(singles, action, strict=True):
            single.step(own[None])
    states = [single.get_room_state(0) for single in singles]
    assert len(set(states)) == 5 and len(states[0].joint_steps) == room.layout.robot.joints
    for rooms in ([], [3], [4, 1, 1], [-1, 0, -5], range(5)):
        assert room.get_room_states(rooms) == [states[i] for i in rooms]
    assert room.get_room_state(-2) == states[3]
    for wrong in (5, -6):
        with pytest.raises(ConfigError, match=f"rooms = {wrong}.*numbers from -5 to 4"):
            room.get_room_states([0, wrong])


def test_states_of_another_robot_or_engine_are_refused():
    room = make_rooms(1, instances=1, config=get_preset("paper-one-button"))
    room.reset(torch.tensor([0]))
    state = room.get_room_state(0)
    for wrong in (state._replace(joint_steps=(1,)), state._replace(z=0.3), state._replace(heading_offset=0.1)):
        with pytest.raises(StateError):
            room.set_room_state(0, wrong)
    arm = make_rooms(1, instances=1, config=get_preset("arm-two-button"))
    arm.reset(torch.tensor([0]))
    state = arm.get_room_state(0)
    with pytest.raises(StateError, match="whole steps"):
        arm.set_room_state(0, state._replace(joint_offsets=(0.1,) * len(state.joint_steps)))


# --- puzzles ---------------------------------------------------------------------------


@pytest.mark.nightly_for("31", "32", "63", "64")
@pytest.mark.parametrize("count", [1, 2, 31, 32, 63, 64])
def test_puzzles_follow_their_scalar_rules_up_to_64_bits(count):
    rng = np.random.default_rng(count)
    edges = [(i, j) for j in range(count) for i in range(j) if rng.random() < 1.5 / max(1, j)]
    puzzles = [ButtonsPuzzle(count, tuple(edges), goal, rule, off)
               for goal in (0, count - 1) for rule in ("ignore", "reset") for off in (False, True)]
    for group in (puzzles, [BitFlipConfig(count=count).make_puzzle(rng)]):
        form = get_tensor_puzzle(group[0].kind)
        frame = SpaceLayout(target_names=group[0].target_names, bounds=group[0].bounds)
        tables = {name: torch.from_numpy(table) for name, table in form.make_tables(group, frame).items()}
        states = [puzzle.make_state() for puzzle in group]
        words = torch.tensor([as_signed(state) for state in states])
        for _ in range(150):
            near = min(int(rng.geometric(0.2)) - 1, count - 1)
            presses = [tuple(np.flatnonzero(rng.random(count) < 0.6 ** np.abs(np.arange(count) - near)).tolist())
                       for _ in group]
            bits = torch.tensor([as_signed(sum(1 << i for i in pressed)) for pressed in presses])
            none = torch.zeros(len(bits))
            touched = TensorContacts(bits, none, bits, 0 * bits, bits != 0, none, none, 0 * bits - 1,
                                     0 * bits - 1)
            words = form.update(tables, words, touched, count)
            states = [puzzle.update(state, base.Contacts(pressed))
                      for puzzle, state, pressed in zip(group, states, presses, strict=True)]
            assert [word % 2**64 for word in words.tolist()] == states
            solved = [puzzle.is_solved(state) for puzzle, state in zip(group, states, strict=True)]
            assert form.is_solved(tables, words).tolist() == solved


def test_solving_a_room_of_64_bits_ends_the_episode():
    config = RoomConfig(room=ShapeConfig(width=60, depth=60),
                        puzzle=ButtonsConfig(count=64, goal=63, graph=GraphConfig(kind="chain")))
    instance = generate(config, 0)
    room = TensorRoom(Rooms(instance=instance))
    room.reset(torch.tensor([0]))
    x, y = instance.exit.centre
    state = room.get_room_state(0)._replace(x=x, y=y, puzzle=2**64 - 1)
    room.set_room_state(0, state)
    assert room.get_room_state(0) == state
    outcome = room.step(torch.tensor([4]))
    assert bool(outcome.terminated) and outcome.reward.item() == 99.0
    assert outcome.info.buttons_on.tolist() == [[1] * 64]


# --- thresholds ------------------------------------------------------------------------


def test_the_edges_of_the_exit_count_to_the_last_bit():
    instance = generate(get_preset("paper-two-button"), 0)
    area, room = instance.exit, TensorRoom(Rooms(8, instance=instance))
    inside = [(area.x_min, area.y_min), (area.x_max, area.y_max), (area.x_min, area.y_max), (area.x_max, area.y_min)]
    outside = [(np.nextafter(area.x_min, -99), 5.0), (np.nextafter(area.x_max, 99), 5.0),
               (5.0, np.nextafter(area.y_min, -99)), (5.0, np.nextafter(area.y_max, 99))]
    room.reset(torch.arange(8))
    x, y = torch.tensor(np.array(inside + outside).T)  # some in a wall, where no episode comes
    room.state = room.state._replace(x=x, y=y, puzzle=torch.full((8,), 3))
    assert room.step(torch.full((8,), 4)).terminated.tolist() == [True] * 4 + [False] * 4


@pytest.mark.parametrize(("name", "gap"), [("four-button-chain", 0), ("arm-two-button", 0), ("arm-two-button", 0.03)])
def test_touching_begins_within_two_micrometres_of_its_reach(name, gap):
    instance = generate(get_preset(name), 0)
    target, turned = instance.targets[0], 5  # what a right turn leaves at heading 5 - 1
    hand = Kinematics(instance).get_hand_in_base((0,) * instance.robot.joints)
    if instance.dynamics.press_with == "hand":  # hang the button so that the outstretched hand is just below it
        target = dataclasses.replace(target, z=hand[2] + target.half_z + gap)
        instance = dataclasses.replace(instance, targets=(target, *instance.targets[1:]))
    else:
        hand = (0.0, 0.0, 0.0)
    rules, room = Kinematics(instance), TensorRoom(Rooms(4, instance=instance), autoreset="disabled")
    room.reset(torch.arange(4))
    reach = instance.compute_press_reach(target, hand[2])
    assert reach > 0
    aim_cos, aim_sin = rules.get_rotation(turned - 1, 0.0)
    away_x, away_y = aim_cos * hand[0] - aim_sin * hand[1], aim_sin * hand[0] + aim_cos * hand[1]
    cos, sin = np.cos(target.yaw), np.sin(target.yaw)
    for number, (along, error) in enumerate([(True, -2e-6), (True, 2e-6), (False, -2e-6), (False, 2e-6)]):
        a, b = (target.half_x + reach + error, 0.0) if along else (0.0, target.half_y + reach + error)
        x, y = target.x + cos * a - sin * b - away_x, target.y + sin * a + cos * b - away_y
        room.state.x[number], room.state.y[number] = float(x), float(y)  # perhaps in a wall
    room.state = room.state._replace(heading_steps=torch.full((4,), turned, dtype=torch.int32),
                                     touching=torch.zeros(4, dtype=torch.int64))
    pressed = room.step(torch.full((4,), 5)).info.pressed
    assert pressed[:, 0].tolist() == [1, 0, 1, 0]


def test_the_door_is_shut_until_solved_but_never_on_the_robot():
    instance = generate(get_preset("clutter"), 0)
    rules, door = Kinematics(instance), instance.door
    start, solved = rules.make_state(instance.starts[0]), (1 << len(instance.targets)) - 1
    away = np.array([np.sign(door.x), 0.0]) if abs(door.x) > abs(door.y) else np.array([0.0, np.sign(door.y)])
    ways = []
    for puzzle in (0, solved):
        for distance in (-1.0, -0.601, -0.3, 0.0, 0.4):  # before the door, against it, in it
            for heading in (0, 9, 18, 27):
                x, y = np.array([door.x, door.y]) + distance * away
                ways.append(start._replace(x=float(x), y=float(y), heading_steps=heading, puzzle=puzzle))
    room = TensorRoom(Rooms(len(ways), instance=instance), autoreset="disabled")
    room.reset(torch.arange(len(ways)))
    for number, state in enumerate(ways):
        room.set_room_state(number, state)
    room.step(torch.full((len(ways),), FORWARD))
    moved = 0
    for number, state in enumerate(ways):
        found, expected = room.get_room_state(number), rules.step(state, FORWARD).state
        assert abs(found.x - expected.x) + abs(found.y - expected.y) < 1e-9
        moved += (found.x, found.y) != (state.x, state.y)
    assert 20 < moved < len(ways)


# --- compilation -----------------------------------------------------------------------


@pytest.mark.nightly_for("config0-1")
@pytest.mark.parametrize(("config", "instances"), [
    (dataclasses.replace(NOISY, obstacles=ObstaclesConfig(), dynamics=DynamicsConfig()), 1),
    pytest.param(dataclasses.replace(NOISY, obstacles=ObstaclesConfig(count=1)), 3, marks=pytest.mark.slow)])
def test_compiled_rooms_do_what_eager_ones_do_and_never_recompile(config, instances, monkeypatch):
    seeds, rooms = list(range(33)), {"config": config, "instances": instances, "observation": "features"}
    eager = play(make_rooms(33, **rooms), seeds)
    compiled = make_rooms(33, **rooms, compile=True)
    compiled.reset(torch.tensor(seeds))
    compiled.step(torch.zeros(33, dtype=torch.int64))
    monkeypatch.delattr(compilation, "standalone_compile")
    found = play(compiled, seeds)
    play(make_rooms(33, **rooms, compile=True), seeds)  # another batch of the same shape
    assert (found - eager).abs().max() < 1e-5
    assert torch.equal(found[:, :, -3:], eager[:, :, -3:])
    compiled.state = compiled.state._replace(x=compiled.state.x.to(torch.float32))
    with pytest.raises(BatchError, match=r"float32.* shape \(33,\), torch.float64"):
        compiled.step(torch.zeros(33, dtype=torch.int64))


def test_a_room_takes_less_than_two_kilobytes():
    config = RoomConfig(room=ShapeConfig(width=60, depth=60), puzzle=ButtonsConfig(count=64))
    room = make_rooms(10, instances=1, config=config)
    room.reset(torch.arange(10))
    sizes = []
    map_tensors(lambda field: sizes.append(field.numel() * field.element_size()), room.state)
    assert sum(sizes) / 10 < 200


# --- refusals --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "error", "words"),
    [
        (torch.tensor([0, 1]), BatchError, r"\(2,\).* shape \(3,\)"),
        (torch.tensor([0.0, 1.0, 2.0]), BatchError, "float32"),
        (torch.tensor([True, False, True]), BatchError, "bool"),
        ([0, 1, 2], BatchError, "a list"),
        (torch.tensor([0, 6, 1]), ActionError, "6 is not one of 0 to 5"),
        (torch.tensor([0, -1, 1]), ActionError, "-1 is not one of 0 to 5"),
        (torch.zeros(3, dtype=torch.int64, device="meta"), BatchError, "on meta"),
    ],
)
def test_a_wrong_action_gets_one_clear_error(action, error, words):
    room = make_rooms(3)
    room.reset(torch.arange(3))
    with pytest.raises(error, match=words):
        room.step(action)


def test_small_integer_actions_are_taken():
    for dtype in (torch.int8, torch.uint8, torch.int32):
        room = make_rooms(3)
        room.reset(torch.arange(3))
        assert room.step(torch.tensor([0, 1, 2], dtype=dtype)).reward.tolist() == [-1.0] * 3


def test_stepping_before_the_first_reset_is_refused():
    with pytest.raises(ResetNeededError):
        make_rooms(2).step(torch.tensor([0, 0]))
    with pytest.raises(ResetNeededError):
        make_rooms(2).reset()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"num_envs": 0}, ConfigError, "num_envs = 0"),
        ({"instance": []}, ConfigError, "at least one RoomInstance"),
        ({"instance": [generate(get_preset("push-block"), 0)]}, UnsupportedError, "make_vec"),
        ({"instance": [generate(get_preset(n), 0) for n in ("paper-one-button", "larg-2019")]}, UnsupportedError,
         "differs from instance 0 in robot"),
        ({"instance": [generate(get_preset(n), 0) for n in ("ten-button", "twenty-button")]}, UnsupportedError,
         "number of targets"),
    ],
)
def test_rooms_that_cannot_be_batched_get_one_clear_error(change, error, words):
    settings = {"instance": [generate(get_preset("paper-one-button"), 0)], "num_envs": 2} | change
    with pytest.raises(error, match=words) as caught:
        TensorRoom(Rooms(**settings))
    assert isinstance(caught.value, EscapeError)


def test_an_unknown_autoreset_is_refused():
    with pytest.raises(ConfigError, match="next-step, same-step, disabled"):
        TensorRoom(Rooms(), autoreset="sometimes")  # type: ignore[arg-type]  # refused


def test_compiling_without_a_compiler_is_refused(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(UnsupportedError, match="no 'no-such-compiler'.*compile=False"):
        make_rooms(1, compile=True)


def test_planned_steps_are_executed_as_predicted():
    instance = generate(get_preset("paper-two-button"), 0)
    room, rules = TensorRoom(Rooms(instance=instance)), Kinematics(instance)
    room.reset(torch.tensor([3]))
    state = rules.make_state(instance.starts[0], room.get_room_state(0).noise_key)
    for action in [LEFT] * 9 + [FORWARD] * 4:
        transition = rules.step(state, action)
        room.step(torch.tensor([action]))
        state = transition.state
        assert room.get_room_state(0) == state
