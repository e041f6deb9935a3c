"""Options over velocities: `OptionsEnv` on the continuous door, with tracked plans."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.trajectories import drive, list_configs
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.options.option import FunctionOption
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, make_goal


def change(preset: str, **dynamics):
    config = get_preset(preset)
    return dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, **dynamics))


@pytest.mark.nightly_for("config1")
@pytest.mark.parametrize("config", [get_preset("paper-two-button"), get_preset("arm-two-button"),
                                    change("paper-two-button", noise=0.1)])
def test_random_options_escape_and_each_presses_its_own_target(config):
    env = OptionsEnv(EscapeRoomContinuousEnv(config), discount=0.999)
    assert env.action_names == ("press-button-1", "press-button-2", "go-to-exit")
    _, info = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(40):
        choice = int(rng.choice(np.flatnonzero(info["action_mask"])))
        _, reward, terminated, truncated, info = env.step(choice)
        option, name = info["option"], env.action_names[choice]
        assert option["ended"] == "reached" and not info["also_pressed"].any()
        assert np.flatnonzero(info["pressed"]).tolist() == ([] if name == "go-to-exit" else [int(name[-1]) - 1])
        bonus = 100.0 if terminated else 0.0
        assert reward == pytest.approx(bonus - 0.1 * info["duration"])
        assert info["discount"] == pytest.approx(0.999 ** info["duration"])
        if terminated:
            break
    assert terminated and info["is_success"] and not truncated


@pytest.mark.nightly_for("taxi-0.1-auto", "foraging-0.0-auto")
@pytest.mark.parametrize(("preset", "slip", "planner"), [
    ("taxi", 0.1, "auto"), ("foraging", 0.0, "auto"), ("door-key", 0.0, "fields"),
    pytest.param("key-corridor", 0.0, "auto", marks=pytest.mark.slow),
    pytest.param("blocks-world", 0.0, "auto", marks=pytest.mark.slow)])
def test_options_carry_until_the_robot_is_out(preset, slip, planner):
    """Each does what it is for; in foraging nobody knows where the next worm will be."""
    env = OptionsEnv(EscapeRoomContinuousEnv(change(preset, slip=slip), time_limit=1e5), planner=planner)
    primitives = OptionsEnv(EscapeRoomEnv(change(preset, slip=slip)), include_primitives=False)
    assert env.action_names == primitives.action_names
    _, info = env.reset(seed=0)
    room, terminated = env.unwrapped, False
    goals = [option.goal for option in env.options]
    while not terminated:
        before = room.get_state()
        steps = room.instance.symbolic_model.find_fewest(room.instance.puzzle.symbolic.get_facts(before.puzzle))
        choice = goals.index(make_goal(steps[0], room.instance) if steps else ExitGoal())
        assert info["action_mask"][choice]
        _, _, terminated, truncated, info = env.step(choice)
        assert info["option"]["ended"] == "reached" and not truncated
        assert not steps or room.get_state().puzzle != before.puzzle
    assert info["is_success"]


@pytest.mark.nightly
def test_targets_are_pressed_under_physics():
    env = OptionsEnv(EscapeRoomContinuousEnv(change("paper-two-button", kind="physics")))
    env.reset(seed=0)
    for choice in (1, 0, 1):
        _, _, _, _, info = env.step(choice)
        assert info["option"]["ended"] == "reached" and np.flatnonzero(info["pressed"]).tolist() == [choice]
    env.close()


@pytest.mark.nightly_for("arm-two-button-14", "clutter, rectangle-0", "arm-two-button-2")
@pytest.mark.parametrize(("name", "seed"), [
    ("paper-random", 0),  # two panels side by side, of which one is touched: it is solid, and stands in the way
    ("clutter, rectangle", 0),  # a way that ends on the edge of the exit ends outside by a rounding
    ("arm-two-button", 2),  # a hand that slides over the panel it has pressed does not press it again
    ("arm-two-button", 14),  # a joint that physics left beyond its limit
])
@pytest.mark.nightly_for("paper-random-0")
def test_every_option_of_an_escape_ends_as_planned_under_physics(name, seed):
    escaped, faults, _ = drive(list_configs()[name], seed, "auto")
    assert escaped and not any(faults)


def test_options_of_your_own_choose_velocities():
    ahead = FunctionOption("ahead", lambda state: np.array([1.0, 0.0, 0.0]), lambda state: float(state.x > 2.0))
    env = OptionsEnv(EscapeRoomContinuousEnv("paper-two-button"), [ahead])
    env.reset(seed=0)
    before = env.unwrapped.get_state()
    _, reward, _, _, info = env.step(0)
    after = env.unwrapped.get_state()
    assert before.y == after.y and 2.0 < after.x <= 2.1 + 1e-9
    assert info["duration"] == round((after.x - before.x) / 0.1) and reward == pytest.approx(-0.1 * info["duration"])
