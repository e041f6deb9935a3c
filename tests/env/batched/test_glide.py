"""Velocities in the batch: the scalar rules to rounding, the single environment step by step, and what is refused."""

from __future__ import annotations

import dataclasses
import math

import gymnasium
import numpy as np
import pytest
import torch

from benchmarks.conformance import compare, draw_actions
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.continuous_vector_env import EscapeRoomContinuousVectorEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.velocities import Velocities
from hrl_escape.errors import BatchError, ConfigError, ResetNeededError, UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from tests.covering import thin
from tests.env.gliding import list_velocities
from tests.env.rooms import all_configs

FAST = Velocities(0.25, speed=4.0, turn_speed=3.0, joint_speed=3.0)
ID = "hrl_escape/EscapeRoomContinuous-v1"


def list_families():
    """All kinematic rooms; rectangles, a differential drive, noise and blocked moves that stay."""
    found = {name: config for name, config in all_configs().items() if config.dynamics.kind == "kinematic"}
    rectangle = {"footprint": "rectangle", "body_length": 1.0, "body_width": 0.6}
    for name, robot, dynamics in (("clutter", rectangle, {}), ("clutter", {"drive": "differential"}, {}),
                                  ("door", rectangle, {}), ("paper-two-button", rectangle, {"noise": 0.2, "slip": 0.1}),
                                  ("arm-two-button", {}, {"noise": 0.2, "slip": 0.1, "blocked": "stay"}),
                                  ("door-key", {}, {"noise": 0.2, "slip": 0.2, "blocked": "contact"}),
                                  ("taxi", {}, {"blocked": "contact"})):
        config = found[name]
        found[f"{name}, {' '.join(map(str, (*robot.values(), *dynamics)))}"] = dataclasses.replace(
            config, robot=dataclasses.replace(config.robot, **robot),
            dynamics=dataclasses.replace(config.dynamics, **dynamics))
    return found


FAMILIES = list_families()


CARRYING = [name for name, config in sorted(FAMILIES.items()) if config.robot.gripper or name == "sokoban"]
PRESSING = sorted(FAMILIES.keys() - CARRYING)


@pytest.mark.nightly_for("largest")
@pytest.mark.parametrize("name", [*thin([name for name in PRESSING if "rectangle" not in name], 6),
                                  *(name for name in PRESSING if "rectangle" in name), *thin(CARRYING, 2)])
def test_velocities_move_the_batch_as_the_scalar_rules(name):
    found = compare([generate(FAMILIES[name], 0)], 150, copies=10, velocities=FAST)
    assert not found.disagreements, found.disagreements[0]
    assert found.primitives >= 150 and found.close_calls <= 1
    assert found.worst < 1e-9


@pytest.mark.nightly_for("blocks-world-1", "door-key-2", "sokoban-3")
@pytest.mark.parametrize(("preset", "seed"), [("taxi", 0), ("blocks-world", 1), ("door-key", 2), ("sokoban", 3)])
def test_a_plan_that_grips_or_pushes_played_as_velocities_leads_to_the_same_states(preset, seed):
    planner, velocities = RoomPlanner(generate(get_preset(preset), seed)), Velocities(speed=5.0, turn_speed=4.0)
    rules, changes = planner.rules, 0
    plan = planner.solve(rules.make_state(planner.instance.starts[0]))
    batch = TensorRoom(Rooms(1, instance=plan.instance), autoreset="disabled", velocities=velocities)
    batch.reset(torch.zeros(1, dtype=torch.int64))
    batch.set_room_state(0, plan.states[0])
    state = plan.states[0]
    for action in plan.primitives:
        for rates in list_velocities(rules, action, 7, velocities.time_step):  # none ends on the edge of a pad
            done = velocities.judge(rules.glide(state, velocities.make_glide(rules, state, tuple(rates.tolist()))),
                                    plan.instance)
            outcome, before, state = batch.step(torch.from_numpy(rates)[None]), state, done.state
            found = batch.get_room_state(0)
            assert max(abs(found.x - state.x), abs(found.y - state.y)) < 1e-9
            assert abs(math.remainder(rules.get_heading(found) - rules.get_heading(state), math.tau)) < 1e-9
            assert (found.puzzle, found.touching) == (state.puzzle, state.touching)
            assert float(outcome.reward) == pytest.approx(done.reward)
            assert (bool(outcome.terminated), bool(outcome.info.success)) == (done.terminated, done.terminated)
            changes += state.puzzle != before.puzzle
            if done.terminated:
                break
    assert done.terminated and changes >= len(plan.parts) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_the_engines_agree_over_a_hundred_thousand_velocities(name):
    """`pytest -m slow tests/env/batched/test_glide.py`, a minute or so a family."""
    found = compare([generate(FAMILIES[name], seed) for seed in range(4)], 25_000, copies=250, velocities=FAST)
    assert found.primitives == 100_000
    assert not found.disagreements, found.disagreements[0]
    assert found.is_good and found.worst < 1e-9


@pytest.mark.gpu
@pytest.mark.parametrize("is_compiled", [False, True])
@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_velocities_on_an_accelerator_do_what_they_do_on_the_cpu(name, is_compiled):
    found, instances = [], [generate(FAMILIES[name], seed) for seed in range(2)]
    for device in ("cpu", "cuda"):
        batch = TensorRoom(Rooms(64, instance=instances, device=device, compile=is_compiled and device == "cuda"),
                           velocities=FAST)
        batch.reset(torch.arange(64, device=device))
        rng, rows = np.random.default_rng(0), []
        for step in range(200):
            if step % 5 == 0:  # held, so that robots cross their rooms
                rates = torch.from_numpy(draw_actions(batch, rng))
            outcome = batch.step(rates.to(device))
            at = batch.state
            rows.append(torch.stack([field.double().cpu() for field in (at.x, at.y, at.puzzle, outcome.reward)]))
        found.append(torch.stack(rows))
    assert found[0][:, :2].std(0).max() > 0.5, "robots move"
    assert (found[0] - found[1]).abs().max() < 1e-9


@pytest.mark.parametrize("preset", ["paper-random", "arm-two-button"])
def test_a_vector_of_rooms_is_the_single_environment_many_times(preset):
    """A time limit that ends between two steps, so that both must round it alike."""
    given = {"config": preset, "observation": "features", "time_limit": 3.05, "speed": 2.0}
    many = gymnasium.make_vec(ID, num_envs=3, **given)
    single = gymnasium.make(ID, **given).unwrapped
    assert isinstance(many.unwrapped, EscapeRoomContinuousVectorEnv)
    assert many.single_action_space == single.action_space
    assert many.single_observation_space == single.observation_space
    many.action_space.seed(0)
    seen, infos = many.reset(seed=5)
    single.reset(options={"state": many.unwrapped.room.get_room_state(1)})
    assert set(infos) >= {"seconds", "time_step", "is_success", "pressed"} and "primitives" not in infos
    actions = np.zeros(())
    for step in range(31):
        actions = 1.5 * many.action_space.sample()  # beyond the bounds, too
        seen, reward, terminated, truncated, infos = many.step(actions)
        expected, pay, over, cut, info = single.step(actions[1])
        assert seen[1] == pytest.approx(expected, abs=1e-6)
        assert (reward[1], terminated[1], truncated[1]) == (pytest.approx(pay), over, cut)
        assert (infos["seconds"][1], infos["time_step"][1]) == (info["seconds"], info["time_step"])
        assert np.array_equal(infos["pressed"][1], info["pressed"])
        if over:
            return
        assert cut == (step == 30)
    seen, reward, *_ = many.step(actions)  # the next episode begins
    assert not reward.any() and not many.step(0.0 * actions)[4]["seconds"].max() > 0.1 + 1e-12


def test_an_escape_pays_the_exit_and_the_second_that_it_did_not_take():
    env = EscapeRoomContinuousVectorEnv(1, "paper-one-button", time_step=0.5, speed=2.0, output="torch")
    single = env.make_single_env()
    assert single.velocities == env.velocities
    env.reset(seed=0)
    room = env.room
    state = room.get_room_state(0)
    exit_, puzzle = single.instance.exit, single.instance.puzzle
    solved = puzzle.list_starts()[0] | 1
    beside = state._replace(x=(exit_.x_min + exit_.x_max) / 2, y=(exit_.y_min + exit_.y_max) / 2, puzzle=solved)
    room.set_room_state(0, beside)
    _, reward, terminated, _, infos = env.step(torch.zeros(1, 3))
    assert bool(terminated) and float(reward) == single.instance.reward.on_exit - 0.5 * single.instance.reward.step
    assert float(infos["seconds"]) == 0.5 and infos["seconds"].dtype == torch.float64


@pytest.mark.slow
def test_compiled_velocities_do_what_eager_ones_do():
    made = [EscapeRoomContinuousVectorEnv(64, "arm-two-button", num_instances=3, resample_instance=True, output="torch",
                                          compile=compiled, time_limit=2.0) for compiled in (False, True)]
    rng = np.random.default_rng(0)
    for env in made:
        env.reset(seed=0)
    for _ in range(60):
        actions = torch.from_numpy(rng.uniform(-2, 2, (64, 6)))
        eager, compiled = (env.step(actions) for env in made)
        for mine, theirs in zip(eager[:4], compiled[:4], strict=True):
            assert torch.allclose(mine.double(), theirs.double(), atol=1e-5)
    assert (made[0].room.state.x - made[1].room.state.x).abs().max() < 1e-9
    assert int(made[0].room.state.episode.min()) == 2


def test_wrong_rooms_actions_and_settings_are_named():
    physics = dataclasses.replace(get_preset("paper-two-button"), dynamics=dataclasses.replace(
        get_preset("paper-two-button").dynamics, kind="physics"))
    with pytest.raises(UnsupportedError, match="physics"):
        EscapeRoomContinuousVectorEnv(2, physics)
    with pytest.raises(ConfigError, match="time_step"):
        EscapeRoomContinuousVectorEnv(2, time_step=-1.0)
    env = EscapeRoomContinuousVectorEnv(2, autoreset_mode="Disabled", time_limit=0.1)
    env.reset(seed=0)
    for wrong in (np.zeros(2), np.zeros((2, 4)), [["a"] * 3] * 2, torch.zeros(2, 3, dtype=torch.int64),
                  np.full((2, 3), np.nan)):
        with pytest.raises(BatchError, match="action"):
            env.step(wrong)
    assert env.step([[0, 0, 0], [1, 0, 0]])[3].all()
    with pytest.raises(ResetNeededError):
        env.step(np.zeros((2, 3)))
