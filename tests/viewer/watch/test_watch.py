"""Watching shows an agent's own numbers and changes none of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.training.train import load_agent, train
from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import KEPT_DECISIONS, KEPT_EVENTS, KEPT_VALUES, Gate, ObservedChoice, Watch


def watch_steps(watch: Watch, episodes: int = 1) -> tuple[list[ObservedChoice], list[PrimitiveStep]]:
    """What is shown during some episodes, as fast as can be."""
    choices: list[ObservedChoice] = []
    steps: list[PrimitiveStep] = []

    def note(step: PrimitiveStep | None) -> None:
        if step is not None:
            steps.append(step)
        elif watch.choice is not None:
            choices.append(watch.choice)

    watch.on_change = note
    watch.run(episodes)
    return choices, steps


@pytest.mark.nightly
def test_values_shown_are_the_agents_own_at_every_decision(run: Path, two_buttons):
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    agent = load_agent(run, env)
    watch = Watch(open_driver(str(run), two_buttons), Gate(None))
    choices, _ = watch_steps(watch)
    observation, info = env.reset(seed=0)
    assert len(choices) >= 2
    for choice in choices:
        values = agent.compute_values(observation)
        assert choice.values is not None
        np.testing.assert_array_equal(choice.values, values)
        np.testing.assert_array_equal(choice.mask, info["action_mask"] != 0)
        assert choice.action == int(np.argmax(np.where(choice.mask, values, -np.inf)))
        assert choice.state_value == float(values[choice.mask].max())
        observation, _, terminated, truncated, info = env.step(choice.action)
    assert terminated or truncated


def test_smdp_bookkeeping_is_that_of_the_environment(run: Path, two_buttons):
    watch = Watch(open_driver(str(run), two_buttons), Gate(None))
    choices, _ = watch_steps(watch)
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    env.reset(seed=0)
    gamma = watch.driver.agent.gamma
    expected = []
    for choice in choices:
        info = env.step(choice.action)[-1]
        rewards = env.last_rewards
        expected.append((info["option"]["name"], len(rewards), sum(gamma**i * r for i, r in enumerate(rewards)),
                         gamma ** len(rewards)))
    steps = [(done.name, done.transition) for done in watch.decisions]
    shown = [(name, step.duration, step.reward, step.discount) for name, step in steps]
    assert [row[:2] for row in shown] == [row[:2] for row in expected[-len(shown):]]
    np.testing.assert_allclose([row[2:] for row in shown], [row[2:] for row in expected[-len(shown):]], rtol=1e-12)


@pytest.mark.parametrize("name", ["smdp-q-learning", "smdp-ppo", "ddpg", "random"])
def test_an_agent_learns_the_same_whether_it_is_watched_or_not(name: str, one_button):
    budget = 300
    watch = Watch(open_driver(name, one_button), Gate(None))
    steps: list[PrimitiveStep] = []

    def note(step: PrimitiveStep | None) -> None:
        if step is not None:
            steps.append(step)
            if len(steps) >= budget:
                watch.gate.stop()

    watch.on_change = note
    watch.run()
    other = open_driver(name, one_button)
    alone: list[PrimitiveStep] = []
    other.recorder.on_step = alone.append
    train(other.agent, other.env, primitives=budget, seed=0, eval_episodes=0, progress=False)
    assert [step.primitive for step in steps[:budget]] == [step.primitive for step in alone[:budget]]
    assert steps[budget - 1].after == alone[budget - 1].after


@pytest.mark.parametrize("name", ["smdp-ppo", "ddpg"])
def test_policies_without_action_values_show_their_preferences(name: str, one_button):
    driver = open_driver(name, one_button)
    watch = Watch(driver, Gate(None))
    observation, info = driver.env.reset(seed=0)
    mask = np.ones(len(driver.names), dtype=np.bool_)
    choice = watch.read(observation, 0, mask)
    assert choice.meaning == "preference" and choice.values is not None
    best = int(np.argmax(choice.values))
    assert driver.agent.act_greedy(observation, mask, np.random.default_rng(0)) == best
    assert (choice.state_value is None) == (name == "ddpg")


def test_what_is_kept_of_a_long_watch_is_bounded(one_button):
    watch = Watch(open_driver("smdp-q-learning", one_button), Gate(None))
    longest = {"decisions": 0, "events": 0, "values": 0}

    def note(step: PrimitiveStep | None) -> None:
        for name in longest:
            longest[name] = max(longest[name], len(getattr(watch, name)))
        if watch.episode > 120:
            watch.gate.stop()

    watch.on_change = note
    watch.run()
    assert longest == {"decisions": KEPT_DECISIONS, "events": KEPT_EVENTS, "values": KEPT_VALUES}


def test_the_planner_drives_out_of_the_room(clutter):
    watch = Watch(open_driver("oracle", clutter), Gate(None))
    choices, steps = watch_steps(watch)
    assert steps[-1].end == "escaped"
    assert [watch.driver.names[choice.action] for choice in choices][-1] == "go-to-exit"


def test_a_plan_shown_is_what_the_option_then_does(clutter):
    watch = Watch(open_driver("oracle", clutter), Gate(None))
    plans, met = [], []

    def note(step: PrimitiveStep | None) -> None:
        if step is None:
            assert watch.plan is not None
            plans.append(watch.plan)
            met.append([watch.states[-1]])
        else:
            met[-1].append(step.after)

    watch.on_change = note
    watch.run(1)
    for plan, states in zip(plans, met, strict=True):
        assert [s[:7] for s in plan.states] == [s[:7] for s in states]


@pytest.mark.nightly
def test_a_preview_does_not_disturb_the_option_that_runs(clutter):
    plain, asked = (Watch(open_driver("oracle", clutter), Gate(None)) for _ in range(2))
    _, expected = watch_steps(plain)
    steps: list[PrimitiveStep] = []

    def note(step: PrimitiveStep | None) -> None:
        if step is not None:
            steps.append(step)
            for name in asked.previewer.options if len(steps) % 5 == 1 else ():
                asked.previewer.preview(name, step.after)

    asked.on_change = note
    asked.run(1)
    assert [step.after for step in steps] == [step.after for step in expected]
