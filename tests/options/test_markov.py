"""Planned options that are functions of the state, and intra-option learning with them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.options.meta_actions import MarkovOption, PlannedOption, make_meta_options
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.planner import RoomPlanner


def list_states(env: EscapeRoomEnv, count: int) -> list[RoomState]:
    """States along a random walk, every tenth."""
    rng = np.random.default_rng(5)
    env.reset(seed=0)
    states = []
    for step in range(10 * count):
        if step % 10 == 0:
            states.append(env.get_state())
        _, _, terminated, truncated, _ = env.step(int(rng.integers(env.action_space.n)))
        if terminated or truncated:
            env.reset(seed=step)
    return states


@pytest.fixture(scope="module")
def clutter() -> tuple[EscapeRoomEnv, list[RoomState]]:
    env = EscapeRoomEnv("clutter")
    return env, list_states(env, 6)


def make_markov(env: EscapeRoomEnv) -> list[MarkovOption]:
    options = make_meta_options(env.instance, "press-reactive", RoomPlanner(env.instance))
    assert all(isinstance(option, MarkovOption) and option.is_markov for option in options)
    return [option for option in options if isinstance(option, MarkovOption)]


def test_what_an_option_does_depends_on_the_state_and_on_nothing_before_it(clutter):
    env, states = clutter
    first, second = make_markov(env), make_markov(env)

    def ask(options: list[MarkovOption], order: list[int]) -> dict[tuple[int, str], int | None]:
        return {(number, option.name): option.policy(states[number]) if option.initiation(states[number]) else None
                for number in order for option in options}

    forwards = ask(first, list(range(len(states))))
    assert ask(second, list(reversed(range(len(states))))) == forwards
    assert len({chosen for chosen in forwards.values() if chosen is not None}) > 3, "not always the same"


@pytest.mark.nightly
def test_they_press_their_target_in_as_many_primitives_as_a_plan(clutter):
    """The route is found anew at each state, so that the shortest is never longer than what is left of the last."""
    env, states = clutter
    planner = RoomPlanner(env.instance)
    rules = planner.rules
    for option in make_markov(env)[:3]:
        for state in states:
            planned, taken = len(planner.routes.find_route(state, option.goal).primitives), 0
            here = state
            while True:
                here, taken = rules.step(here, option.policy(here)).state, taken + 1
                if option.termination(here):
                    break
                assert taken < planned + 5
            assert isinstance(option.goal, PressGoal) and here.touching >> option.goal.target & 1
            assert taken <= 1.05 * planned + 1


def test_noise_and_slip_need_no_replanning():
    config = get_preset("paper-two-button")
    config = dataclasses.replace(config, dynamics=DynamicsConfig(noise=0.1, slip=0.1))
    env = OptionsEnv(EscapeRoomEnv(config), option_set="press-reactive", include_primitives=False)
    for seed in range(5):
        env.reset(seed=seed)
        for choice in (0, 1, 2):
            _, _, terminated, _, info = env.step(choice)
            assert info["option"]["ended"] == "reached" or terminated
        assert terminated


def test_a_primitive_teaches_all_options_that_would_have_done_the_same():
    for option_set, most in (("press-reactive", 3), ("press", 0)):
        env = OptionsEnv(EscapeRoomEnv("paper-two-button"), option_set=option_set, include_primitives=False, trace=True)
        env.reset(seed=0)
        counts = [len(item.consistent) for choice in (0, 1, 0) for item in env.step(choice)[4]["trace"]]
        assert max(counts) <= most and (min(counts) >= 1) == (option_set == "press-reactive")
        assert (max(counts) > 1) == (option_set == "press-reactive"), "some primitives lead to several goals"


def test_meta_actions_keep_their_names_and_pushes_their_plans():
    room = EscapeRoomEnv("push-block", instance_seed=1).instance
    plain, markov = (make_meta_options(room, option_set) for option_set in ("press", "press-reactive"))
    assert [option.name for option in plain] == [option.name for option in markov]
    assert [option.about for option in plain] == [option.about for option in markov]
    assert not markov[0].is_markov and isinstance(markov[-1], MarkovOption) and isinstance(plain[-1], PlannedOption)
