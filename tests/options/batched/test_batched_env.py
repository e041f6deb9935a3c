"""Batched options through their own door: the SMDP contract, agreement with `OptionsEnv`, independence of rooms."""

import dataclasses

import numpy as np
import pytest
import torch

from benchmarks.options_conformance import compare_options
from benchmarks.reference_search import find_fewest_primitives
from hrl_escape.env.batched import compilation
from hrl_escape.env.config import DynamicsConfig, ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ActionError, BatchError, ConfigError, ResetNeededError
from hrl_escape.options.batched.env import ENDINGS, BatchedOptionsEnv
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import PressGoal
from tests.env.rooms import all_configs

FORWARD, TURN_LEFT = 0, 4
META_1, META_2, META_EXIT = 6, 7, 8  # in a room with two buttons
SMALL = RoomConfig(name="small", room=ShapeConfig(width=6, depth=6), robot=RobotConfig(body_radius=0.3),
                   puzzle=ButtonsConfig(count=2, buttons=Panels(width=0.6)), start=StartConfig(choices=5))
NOISY = dataclasses.replace(SMALL, dynamics=DynamicsConfig(noise=0.05, slip=0.1))
WITH_DOOR = dataclasses.replace(SMALL, exit=ExitConfig(door=True, width=1.2))


def make_env(count=1, config=SMALL, horizon=None, **more):
    instance = generate(get_preset(config) if isinstance(config, str) else config, 0)
    if horizon is not None:
        instance = dataclasses.replace(instance, horizon=horizon)
    return BatchedOptionsEnv(count, instance=instance, **more)


def begin(env, first=0):
    env.reset(torch.arange(env.count) + first)
    return env


def decide(env, action, most=300):
    """Steps all rooms until the decision of room 0 ends; its row."""
    for _ in range(most):
        done = env.step(torch.full((env.count,), action))
        if done.where[0]:
            return type(done)(*(field[0] for field in done))
    raise AssertionError("the decision does not end")


# --- the SMDP contract -------------------------------------------------------------------


@pytest.mark.nightly
def test_every_field_is_that_of_options_env():
    env = begin(make_env(discount=0.9, observation="state"))
    single = OptionsEnv(EscapeRoomEnv(instance=env.room.instances[0]), discount=0.9)
    single.reset(seed=0)
    assert env.action_names == single.action_names
    for action in (META_2, FORWARD, META_1, META_2, META_EXIT):
        state = env.room.get_room_state(0)
        single.unwrapped.set_state(state)
        assert env.action_mask[0].tolist() == single.resume().astype(bool).tolist()
        before, done = env.observation[0].clone(), decide(env, action)
        seen, reward, terminated, truncated, info = single.step(action)
        assert int(done.duration) == info["duration"], "in so small a room greed and plan take as many primitives"
        assert (done.reward, bool(done.terminated), bool(done.truncated)) == (reward, terminated, truncated)
        assert done.discounted_reward.item() == pytest.approx(info["discounted_reward"], rel=1e-5)
        assert done.discount.item() == pytest.approx(info["discount"], rel=1e-5)
        assert ENDINGS[done.ended] == info["option"]["ended"] == "reached"
        assert [i for i in range(2) if int(done.pressed) >> i & 1] == np.flatnonzero(info["pressed"]).tolist()
        assert (int(done.action), int(done.primitives)) == (action, info["primitives"])
        assert torch.equal(done.observation, before)
        if action == FORWARD:
            np.testing.assert_allclose(done.next_observation.numpy(), seen, atol=1e-6)
    assert done.terminated


def test_the_exit_inside_an_option_keeps_its_bonus_and_the_state_reached_is_not_the_next_episodes():
    env = begin(make_env(discount=0.9, observation="state"))
    start = env.observation[0].clone()
    for action in (META_1, META_2):
        decide(env, action)
    done = decide(env, META_EXIT)
    k = int(done.duration)
    assert done.terminated and not done.truncated and done.reward == 100 - k
    assert done.discounted_reward.item() == pytest.approx(-(1 - 0.9**k) / 0.1 + 100 * 0.9 ** (k - 1), rel=1e-5)
    exit_ = env.room.instances[0].exit
    assert exit_.contains(*done.next_observation[:2].tolist())
    assert done.next_observation[6:8].tolist() == [1, 1], "the buttons as they were at the exit"
    assert env.observation[0, 6:8].tolist() == [0, 0] and env.room.state.episode[0] == 1
    assert torch.equal(start[2:3], env.observation[0, 2:3])


@pytest.mark.nightly
def test_the_cap_inside_an_option_truncates_and_counts_what_ran():
    env = begin(make_env(config="paper-two-button", horizon=4, discount=0.9, observation="state"))
    done = decide(env, META_2)
    assert done.truncated and not done.terminated and ENDINGS[done.ended] == "episode-over"
    assert int(done.duration) == 4 and done.discount.item() == pytest.approx(0.9**4)
    assert done.next_observation[:2].abs().max() > 3.9, "bootstrap from where four moves have led"


def test_no_room_waits_for_another():
    env = begin(make_env(3, config="paper-two-button"))
    ends = []
    for _ in range(9):
        done = env.step(torch.tensor([TURN_LEFT, META_1, META_2]))
        ends.append(done.where.tolist())
        assert torch.equal(env.is_waiting, done.where)
    ends = np.array(ends)
    assert ends[:, 0].all(), "a primitive ends at once"
    assert ends[:, 1].tolist() == [False] * 8 + [True], "button 1 is nine moves away"


@pytest.mark.nightly
def test_an_episode_begins_wherever_one_has_ended():
    env, alone, generator = BatchedOptionsEnv(8, "paper-one-button"), 0, torch.Generator().manual_seed(0)
    env.reset(0)
    for _ in range(150):
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=generator).squeeze(1))
        over = done.where & (done.terminated | done.truncated)
        alone += bool(over.any()) and not bool(over.all())
        assert not env.is_over.any() and torch.equal(env.is_waiting[over], over[over])
    assert alone > 3


def test_an_action_for_a_room_that_is_busy_is_not_read():
    env = begin(make_env(config="paper-two-button"))
    env.step(torch.tensor([META_1]))
    done = env.step(torch.tensor([-5]))
    while not done.where[0]:
        done = env.step(torch.tensor([999]))
    assert int(done.action) == META_1 and int(done.pressed) == 1


@pytest.mark.nightly
def test_a_masked_option_costs_one_turn():
    env = begin(make_env(config=WITH_DOOR))
    assert env.action_mask[0].tolist() == [True] * 8 + [False], "the door is shut"
    heading = int(env.room.state.heading_steps[0])
    done = decide(env, META_EXIT)
    assert ENDINGS[done.ended] == "planning-failed" and int(done.duration) == 1
    assert int(env.room.state.heading_steps[0]) == (heading + 1) % 36
    for action in (META_1, META_2, META_EXIT):
        done = decide(env, action)
    assert done.terminated, "the open door can be gone through"


def test_options_end_when_they_may_last_no_longer():
    env = begin(make_env(config="paper-two-button", max_duration=3, include_primitives=False))
    done = decide(env, 1)
    assert ENDINGS[done.ended] == "timeout" and int(done.duration) == 3 and not done.truncated
    assert env.actions == 3


@pytest.mark.nightly
def test_without_automatic_reset_a_room_stands_still_until_it_is_reset():
    env = begin(make_env(2, autoreset=False))
    for action in (META_1, META_2, META_EXIT):
        decide(env, action)
    for _ in range(100):
        done = env.step(torch.tensor([0, TURN_LEFT if not env.action_mask[1, META_EXIT] else META_EXIT]))
        assert not done.where[0]
        if env.is_over.all():
            break
    still = env.room.get_room_state(0)
    assert env.is_over[0] and not env.is_waiting[0] and env.room.get_room_state(0) == still
    env.reset(torch.tensor([7, 7]), torch.tensor([True, False]))
    assert env.is_waiting[0] and not env.is_over[0] and env.room.get_room_state(0).primitives == 0
    assert decide(env, META_1).pressed == 1


# --- agreement with planned options --------------------------------------------------------


@pytest.mark.nightly_for("coarse-steps-0.15", "door-0.05", "inner-doors-0.05")
@pytest.mark.parametrize(("name", "most"), [
    pytest.param("clutter", 0.05, marks=pytest.mark.slow), ("door", 0.05), ("inner-doors", 0.05),
    ("coarse-steps", 0.15)])
def test_what_options_env_reaches_is_reached_in_about_as_many_primitives(name, most):
    found = compare_options([generate(all_configs()[name], 1)], 40)
    assert found.decisions >= 40 and found.reached >= 38
    assert not found.missed, found.missed[0]
    assert abs(found.more) < most, "moves of 3.7 m among cells of 6 cm are hardest to foresee"
    assert not found.side_presses


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["four-rooms", pytest.param("key-chest", marks=pytest.mark.slow)])
def test_a_plan_is_not_followed_on_after_a_slip(name):
    found = compare_options([generate(get_preset(name), 0)], 200)
    assert not found.missed, found.missed[0]
    assert found.more < 0.15


def test_where_greed_leads_nowhere_the_planner_is_asked():
    env = begin(make_env(config="paper-two-button", include_primitives=False))
    env.step(torch.tensor([0]))
    env._fields.values.fill_(1)  # fields without information
    done = decide(env, 0)
    assert ENDINGS[done.ended] == "reached" and int(done.duration) <= 9 + 2 * 5, "four primitives in vain, then a plan"


@pytest.mark.nightly
def test_greedy_presses_come_near_the_exact_fewest_primitives():
    instance = generate(SMALL, 3)
    rules = Kinematics(instance)
    env = BatchedOptionsEnv(len(instance.starts), instance=instance, include_primitives=False)
    fewest = taken = 0
    for first in range(8):
        begin(env, first * 10)
        state = env.room.get_room_state(0)
        goal = PressGoal(first % 2)
        fewest += len(find_fewest_primitives(rules, state, goal, *compute_goal_area(goal, instance)) or ())
        taken += int(decide(env, first % 2).duration)
    assert fewest > 20 and fewest <= taken <= 1.05 * fewest


# --- rooms do not know of each other -------------------------------------------------------


def play(env, seeds, steps=60):
    """Everything that rooms hand over, with choices that depend on a room's seed alone."""
    env.reset(torch.tensor(seeds))
    choices = np.stack([np.random.default_rng(seed).integers(env.actions, size=steps) for seed in seeds], axis=1)
    rows = []
    for action in torch.from_numpy(choices):
        done = env.step(action)
        rows.append(torch.cat([torch.where(done.where.unsqueeze(1), torch.stack([
            done.action.double(), done.duration.double(), done.discounted_reward.double(), done.ended.double(),
            done.pressed.double()], dim=1), 0.0), env.observation.double()], dim=1))
    return torch.stack(rows, dim=1)


@pytest.mark.nightly
def test_a_room_meets_the_same_fate_alone_and_in_any_batch():
    seeds = list(range(40, 60))
    together = play(make_env(20, NOISY), seeds)
    order = np.random.default_rng(0).permutation(20).tolist()
    again = play(make_env(20, NOISY), [seeds[i] for i in order])
    assert torch.equal(again, together[order])
    for number in (0, 13):
        assert torch.equal(play(make_env(1, NOISY), [seeds[number]])[0], together[number])


@pytest.mark.nightly
def test_instances_may_differ_and_be_drawn_anew():
    instances = [generate(SMALL, seed) for seed in (0, 1, 2)]
    env = BatchedOptionsEnv(12, instance=instances, resample_instance=True)
    begin(env)
    generator, seen = torch.Generator().manual_seed(0), set()
    for _ in range(250):
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=generator).squeeze(1))
        over = done.where & (done.ended != ENDINGS.index("reached"))
        assert not (over & (done.action >= 6) & ~done.truncated).any(), "every option reaches its goal everywhere"
        seen |= set(env.room.state.instance.tolist())
    assert seen == {0, 1, 2}


@pytest.mark.slow
def test_compiled_steps_do_what_eager_ones_do_and_never_recompile(monkeypatch):
    compiled = make_env(16, NOISY, compile=True)
    found = [play(env, list(range(16))) for env in (make_env(16, NOISY), compiled)]
    assert torch.allclose(found[0], found[1], atol=1e-5)
    monkeypatch.delattr(compilation, "standalone_compile")
    compiled.reset(torch.arange(16), torch.arange(16) < 3)
    compiled.step(torch.zeros(16, dtype=torch.int64))


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"discount": 1.5}, "from 0 to 1"), ({"max_duration": 0}, "at least 1"), ({"num_envs": 0}, "at least 1")],
)
def test_a_wrong_argument_gets_one_clear_error(settings, words):
    with pytest.raises(ConfigError, match=words):
        BatchedOptionsEnv(**{"config": SMALL, **settings})


def test_a_wrong_call_gets_one_clear_error():
    env = make_env(2)
    with pytest.raises(ResetNeededError):
        env.step(torch.zeros(2, dtype=torch.int64))
    begin(env)
    with pytest.raises(BatchError, match=r"\(3,\)"):
        env.step(torch.zeros(3, dtype=torch.int64))
    with pytest.raises(BatchError, match="float32"):
        env.step(torch.zeros(2))
    with pytest.raises(ActionError, match="9 is not one of 0 to 8"):
        env.step(torch.tensor([0, 9]))
