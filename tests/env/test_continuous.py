"""The continuous door: Gymnasium's contract, exact contact, plans played as velocities, and others' SAC and TD3."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset, sokoban
from hrl_escape.env.puzzles.taxi import REFUSED, RIDING, Ride
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, ResetNeededError, UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from tests.env.bullet_world import BulletWorld
from tests.env.gliding import list_velocities


def change(preset: str, robot=None, dynamics=None, **settings):
    config = get_preset(preset)
    return dataclasses.replace(config, robot=dataclasses.replace(config.robot, **(robot or {})),
                               dynamics=dataclasses.replace(config.dynamics, **(dynamics or {})), **settings)


RECTANGLE = {"footprint": "rectangle", "body_length": 1.0, "body_width": 0.6}


@pytest.mark.parametrize("config", [get_preset("arm-two-button"), change("clutter", RECTANGLE),
                                    change("paper-two-button", {"drive": "differential"}),
                                    change("paper-two-button", dynamics={"kind": "physics"})])
def test_it_is_an_environment_of_gymnasium(config):
    env = gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", config=config, observation="features")
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.nightly
def test_the_action_space_is_the_robot_s():
    env = EscapeRoomContinuousEnv("arm-two-button", speed=0.7, joint_speed=20.0)
    assert env.action_space.high == pytest.approx([0.7, 0.7, 1.5, 10.0, 10.0, 10.0]), "the URDF allows 10 rad/s"
    other = EscapeRoomContinuousEnv(change("clutter", {"drive": "differential"}))
    assert other.action_space.shape == (2,)


@pytest.mark.nightly_for("door-free-0")
@pytest.mark.parametrize(("preset", "seed"), [
    ("paper-random", 1), ("arm-two-button", 0), ("door-free", 0), ("taxi", 0), ("blocks-world", 1), ("door-key", 2),
    ("sokoban", 3),
    *(pytest.param(preset, 0, marks=pytest.mark.slow) for preset in ("potions", "lights-out")),
    *(pytest.param(preset, seed, marks=pytest.mark.slow) for seed in range(4, 12)
      for preset in ("taxi", "blocks-world", "door-key", "key-corridor", "multi-room", "sokoban"))])
def test_a_plan_of_primitives_played_as_velocities_reaches_the_same_states(preset, seed):
    config = change("clutter", {"drive": "differential"}) if preset == "door-free" else get_preset(preset)
    planner = RoomPlanner(generate(config, seed))
    plan = planner.solve(planner.rules.make_state(planner.instance.starts[0]))
    env = EscapeRoomContinuousEnv(instance=plan.instance, speed=5.0, turn_speed=4.0, joint_speed=4.0)
    env.reset(options={"state": plan.states[0]})
    total, rules, steps = 0.0, planner.rules, 10
    for action, expected in zip(plan.primitives, plan.states[1:], strict=True):
        for rates in list_velocities(rules, action, steps, env.velocities.time_step):
            _, reward, terminated, _, info = env.step(rates)
            total += reward
            if terminated:
                break
        if terminated:  # the last move may cross the exit before its end
            break
        state = env.get_state()
        assert (state.x, state.y) == pytest.approx((expected.x, expected.y), abs=1e-9)
        assert math.remainder(rules.get_heading(state) - rules.get_heading(expected), math.tau) == pytest.approx(0.0)
        assert rules.get_angles(state) == pytest.approx(rules.get_angles(expected), abs=1e-9)
        assert (state.puzzle, state.touching) == (expected.puzzle, expected.touching)
    assert terminated and info["is_success"] and action == plan.primitives[-1] and expected == plan.states[-1]
    assert 0.0 <= plan.cost - info["seconds"] < 1.0
    saved = rules.instance.reward.step * (plan.cost - info["seconds"])
    assert total == pytest.approx(plan.compute_return() - saved), "a second costs what a primitive does"


@pytest.mark.parametrize("config", [get_preset("clutter"), change("clutter", RECTANGLE)])
def test_contact_is_exact_and_nothing_tunnels_asked_of_bullet(config):
    env = EscapeRoomContinuousEnv(config, time_step=0.25, speed=8.0, turn_speed=3.0)
    env.action_space.seed(0)
    env.reset(seed=0)
    gaps, world = [], BulletWorld(env.rules)
    for _ in range(150):
        env.step(env.action_space.sample())
        gaps.append(world.compute_clearance(env.get_state()))
    assert min(gaps) > CONTACT_SKIN - 5e-5
    assert sum(gap < 2 * CONTACT_SKIN for gap in gaps) > 10, "it meets walls"


def test_the_rules_of_a_step():
    env = EscapeRoomContinuousEnv("arm-two-button", time_step=0.5, speed=2.0)
    env.reset(seed=0)
    before = env.get_state()
    rules = env.rules
    _, reward, _, _, info = env.step(np.array([0.4, 0.0, 1.0, 0.2, 0.0, 0.0]))
    state = env.get_state()
    middle = rules.get_heading(before) + 0.25
    assert (state.x - before.x, state.y - before.y) == pytest.approx((0.2 * math.cos(middle), 0.2 * math.sin(middle)))
    assert rules.get_heading(state) - rules.get_heading(before) == pytest.approx(0.5)
    assert rules.get_angles(state) == pytest.approx((rules.get_angles(before)[0] + 0.1, *rules.get_angles(before)[1:]))
    assert (reward, info["seconds"], info["time_step"]) == (-0.5, 0.5, 0.5)
    high = rules.robot.limits[1][1]
    for _ in range(20):
        env.step(np.array([0.0, 0.0, 0.0, 0.0, 9.0, 0.0]))
    assert rules.get_angles(env.get_state())[1] == high, "clipped to the bound, and stopped at the joint's limit"


def test_the_hand_acts_at_the_end_of_a_step_beyond_half_of_its_level():
    env = EscapeRoomContinuousEnv("taxi", time_step=0.5)
    env.reset(seed=0)
    puzzle, depot = env.instance.puzzle, env.instance.targets[0]
    beside = env.get_state()._replace(x=depot.x + depot.half_x + 0.25, y=depot.y, heading_steps=0, touching=0,
                                      puzzle=puzzle.encode(Ride(passenger=0, destination=1)))
    found = {}
    for level in (-1.0, 0.0, 0.5, 0.51, 9.0):
        env.reset(options={"state": beside})
        reward = env.step(np.array([-0.6, 0.0, 0.0, level]))[1]
        found[level] = puzzle.decode(env.get_state().puzzle).passenger, pytest.approx(reward)
    assert found == {-1.0: (0, -0.5 + REFUSED), 0.0: (0, -0.5), 0.5: (0, -0.5), 0.51: (RIDING, -0.5),
                     9.0: (RIDING, -0.5)}, "it drives onto the pad, then grips"
    assert env.step(np.array([0.0, 0.0, 0.0, 1.0]))[1] == pytest.approx(-0.5 + REFUSED), "a level held is one grip more"


def test_a_gripper_that_grips_does_not_use_and_one_that_slips_does_nothing():
    env = EscapeRoomContinuousEnv("multi-room", speed=4.0, turn_speed=4.0)
    env.reset(seed=0)
    planner = RoomPlanner(env.instance)
    plan = planner.solve(env.get_state())
    before = next(state for state, action in zip(plan.states, plan.primitives, strict=False)
                  if env.rules.actions.primitives[action].name == "use")
    opened = {}
    for levels in ((0.0, 1.0), (1.0, 1.0), (-1.0, 1.0), (0.0, -1.0)):
        env.reset(options={"state": before})
        env.step(np.array([0.0, 0.0, *levels]))
        opened[levels] = env.get_state().puzzle != before.puzzle
    assert opened == {(0.0, 1.0): True, (1.0, 1.0): False, (-1.0, 1.0): False, (0.0, -1.0): False}
    slipping = EscapeRoomContinuousEnv(change("multi-room", dynamics={"slip": 0.5}))
    found = set()
    for key in range(8):
        slipping.reset(seed=0)
        slipping.set_state(before._replace(noise_key=key))
        slipping.step(np.array([0.0, 0.3, 0.0, 1.0]))
        state = slipping.get_state()
        found.add((state.heading_offset != 0.0, state.puzzle != before.puzzle))
    assert found == {(False, False), (True, True)}, "both or none of turn and use"


def test_what_stops_the_base_is_pushed_one_cell_to_the_nearest_side():
    """Cells of 2 m; the body's axis is 1.599 m before the box's middle at contact."""

    def drive(env, steps: int, y: float = 0.0, left: float = 0.0) -> tuple[int, float]:
        """Cells by which the first box has moved, and metres by which the base has."""
        env.reset(seed=0)
        begin = env.get_state()
        env.set_state(begin._replace(y=begin.y + y))
        for _ in range(steps):
            env.step(np.array([1.0, left, 0.0]))
        state, level = env.get_state(), env.instance.puzzle.level
        return env.instance.puzzle.decode(state.puzzle)[0] - level.boxes[0], pytest.approx(state.x - begin.x)

    env = EscapeRoomContinuousEnv(sokoban(rows=("     ", "@$  .", "     ")))
    assert (drive(env, 5), drive(env, 6), drive(env, 25), drive(env, 26)) == ((0, 0.5), (1, 0.6), (1, 2.5), (2, 2.6))
    assert drive(env, 6, y=0.9) == drive(env, 6, left=0.9) == (1, 0.6)
    assert drive(env, 20, y=1.2) == (0, 0.6), "the corner of a box, which no move from there would push"
    assert drive(env, 40, y=1.45) == (0, 4.0), "past it"
    blocked = EscapeRoomContinuousEnv(sokoban(rows=(" .  ", "@$$ ", "  . ")))
    assert drive(blocked, 20) == (0, 0.5), "a box before a box"


def test_states_are_written_back_exactly_and_copies_go_on():
    env = EscapeRoomContinuousEnv("clutter")
    env.action_space.seed(1)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(20)]
    for action in actions[:10]:
        env.step(action)
    twin, kept = pickle.loads(pickle.dumps(env)), env.get_state()
    first = [env.step(action)[0] for action in actions[10:]]
    env.set_state(kept)
    for other in (env, twin):
        assert all(np.array_equal(a, other.step(b)[0]) for a, b in zip(first, actions[10:], strict=True))
    assert twin.describe()["time_step"] == 0.1


def test_time_runs_out_in_seconds():
    env = EscapeRoomContinuousEnv("paper-one-button", time_limit=0.95)
    env.reset(seed=0)
    ends = [env.step(np.zeros(3))[3] for _ in range(10)]
    assert ends == [False] * 9 + [True]
    with pytest.raises(ResetNeededError):
        env.step(np.zeros(3))


def test_physics_moves_as_fast_as_it_is_told():
    env = EscapeRoomContinuousEnv(change("paper-two-button", dynamics={"kind": "physics"}))
    env.reset(seed=0)
    begin = env.get_state()
    places = [env.step(np.array([0.5, 0.0, 0.0])) and env.get_state() for _ in range(10)]
    assert math.hypot(places[-1].x - begin.x, places[-1].y - begin.y) == pytest.approx(0.5, abs=0.02)
    assert all(b.physics != a.physics for a, b in itertools.pairwise([begin, *places][:2]))


def test_wrong_arguments_actions_and_rooms_are_named():
    for wrong in ({"time_step": 0.0}, {"speed": math.inf}, {"time_limit": -1.0}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            EscapeRoomContinuousEnv(**wrong)
    for environment in (EscapeRoomContinuousEnv, EscapeRoomEnv):
        with pytest.raises(UnsupportedError, match="a gripper, which dynamics.kind = 'physics'"):
            environment(change("blocks-world", dynamics={"kind": "physics"}))
    env = EscapeRoomContinuousEnv()
    env.reset(seed=0)
    for wrong in (0, np.zeros(2), np.array([0.0, math.nan, 0.0]), "left"):
        with pytest.raises(ConfigError, match="3 finite numbers"):
            env.step(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["SAC", "TD3"])
def test_stable_baselines3_trains_on_it_unmodified(algorithm):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", config="paper-one-button", observation="features",
                         time_limit=30.0)
    model = getattr(sb3, algorithm)("MlpPolicy", env, learning_starts=50, batch_size=32, seed=0)
    before = [weights.detach().clone() for weights in model.actor.parameters()]
    model.learn(400)
    assert any((a != b).any() for a, b in zip(before, model.actor.parameters(), strict=True))
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    assert env.action_space.contains(action)


@pytest.mark.slow
def test_torchrls_sac_trains_on_it_unmodified():
    import torch
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torchrl.collectors import Collector
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.envs import GymEnv, check_env_specs
    from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
    from torchrl.objectives import SACLoss, SoftUpdate

    env = GymEnv("hrl_escape/EscapeRoomContinuous-v1", config="paper-one-button", observation="features",
                 time_limit=30.0)
    check_env_specs(env)
    torch.manual_seed(0)
    space, size = env.action_spec, env.observation_spec["observation"].shape[-1]
    count = space.shape[-1]
    body = torch.nn.Sequential(MLP(size, 2 * count, num_cells=[32, 32]), NormalParamExtractor())
    actor = ProbabilisticActor(TensorDictModule(body, ["observation"], ["loc", "scale"]), ["loc", "scale"], spec=space,
                               distribution_class=TanhNormal,
                               distribution_kwargs={"low": space.space.low, "high": space.space.high},
                               return_log_prob=True)
    loss = SACLoss(actor, ValueOperator(MLP(size + count, 1, num_cells=[32, 32]), ["action", "observation"]))
    loss.make_value_estimator(gamma=0.99)
    target, optimiser = SoftUpdate(loss, tau=0.005), torch.optim.Adam(loss.parameters(), 3e-4)
    replay = ReplayBuffer(storage=LazyTensorStorage(1_000), batch_size=32)
    before = [weights.detach().clone() for weights in actor.parameters()]
    for batch in Collector(env, actor, frames_per_batch=50, total_frames=400, init_random_frames=50):
        assert space.is_in(batch["action"]) and (batch["next", "reward"] <= 0.0).any()
        replay.extend(batch.reshape(-1))
        for _ in range(10):
            found = loss(replay.sample())
            optimiser.zero_grad()
            (found["loss_actor"] + found["loss_qvalue"] + found["loss_alpha"]).backward()
            optimiser.step()
            target.step()
    assert all(torch.isfinite(weights).all() for weights in actor.parameters())
    assert any((a != b).any() for a, b in zip(before, actor.parameters(), strict=True))
