"""Watching shows an agent's own numbers and changes none of them."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.training import load_agent, train
from hrl_escape.cli import main
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import CheckpointError, FileReadError, RunMismatchError, UnknownNameError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.drivers import open_driver
from hrl_escape.viewer.preview import Previewer
from hrl_escape.viewer.tap import Step
from hrl_escape.viewer.watching import Gate, Thought, Watch


@pytest.fixture(scope="session")
def run(two_buttons, tmp_path_factory) -> Path:
    """A short training run of smdp-dqn, with its room beside it, as `hrl-escape train` leaves it."""
    folder = tmp_path_factory.mktemp("run")
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    two_buttons.save(folder / "room.json")
    train("smdp-dqn", env, primitives=1500, seed=0, out=folder, eval_episodes=0, progress=False)
    return folder


def watch_steps(watch: Watch, episodes: int = 1) -> tuple[list[Thought], list[Step]]:
    """What is shown during some episodes, as fast as can be."""
    thoughts: list[Thought] = []
    steps: list[Step] = []

    def note(step: Step | None) -> None:
        if step is not None:
            steps.append(step)
        elif watch.thought is not None:
            thoughts.append(watch.thought)

    watch.on_change = note
    watch.run(episodes)
    return thoughts, steps


def test_values_shown_are_the_agents_own_at_every_decision(run: Path, two_buttons):
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    agent = load_agent(run, env)
    watch = Watch(open_driver(str(run), two_buttons), Gate(None))
    thoughts, _ = watch_steps(watch)
    observation, info = env.reset(seed=0)
    assert len(thoughts) >= 2
    for thought in thoughts:
        values = agent.compute_values(observation)
        assert thought.values is not None
        np.testing.assert_array_equal(thought.values, values)
        np.testing.assert_array_equal(thought.mask, info["action_mask"] != 0)
        assert thought.action == int(np.argmax(np.where(thought.mask, values, -np.inf)))
        assert thought.state_value == float(values[thought.mask].max())
        observation, _, terminated, truncated, info = env.step(thought.action)
    assert terminated or truncated


def test_smdp_bookkeeping_is_that_of_the_environment(run: Path, two_buttons):
    watch = Watch(open_driver(str(run), two_buttons), Gate(None))
    thoughts, _ = watch_steps(watch)
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    env.reset(seed=0)
    gamma = watch.driver.agent.gamma
    expected = []
    for thought in thoughts:
        info = env.step(thought.action)[-1]
        rewards = info["rewards"]
        expected.append((info["option"]["name"], len(rewards), sum(gamma**i * r for i, r in enumerate(rewards)),
                         gamma ** len(rewards)))
    shown = [(done.name, done.duration, done.reward, done.discount) for done in watch.decisions]
    assert [row[:2] for row in shown] == [row[:2] for row in expected[-len(shown):]]
    np.testing.assert_allclose([row[2:] for row in shown], [row[2:] for row in expected[-len(shown):]], rtol=1e-12)


@pytest.mark.parametrize("name", ["smdp-q-learning", "smdp-ppo", "ddpg", "random"])
def test_an_agent_learns_the_same_whether_it_is_watched_or_not(name: str, one_button):
    budget = 300
    watch = Watch(open_driver(name, one_button), Gate(None))
    steps: list[Step] = []

    def note(step: Step | None) -> None:
        if step is not None:
            steps.append(step)
            if len(steps) >= budget:
                watch.gate.stop()

    watch.on_change = note
    watch.run()
    other = open_driver(name, one_button)
    alone: list[Step] = []
    other.tap.on_step = alone.append
    train(other.agent, other.env, primitives=budget, seed=0, eval_episodes=0, progress=False)
    assert [step.primitive for step in steps[:budget]] == [step.primitive for step in alone[:budget]]
    assert steps[budget - 1].after == alone[budget - 1].after


@pytest.mark.parametrize("name", ["smdp-ppo", "ddpg"])
def test_policies_without_action_values_show_their_preferences(name: str, one_button):
    driver = open_driver(name, one_button)
    watch = Watch(driver, Gate(None))
    observation, info = driver.env.reset(seed=0)
    mask = np.ones(len(driver.names), dtype=np.bool_)
    thought = watch.read(observation, 0, mask)
    assert thought.meaning == "preference" and thought.values is not None
    best = int(np.argmax(thought.values))
    assert driver.agent.act_greedy(observation, mask, np.random.default_rng(0)) == best
    assert (thought.state_value is None) == (name == "ddpg")


def test_the_planner_drives_out_of_the_room(clutter):
    watch = Watch(open_driver("planner", clutter), Gate(None))
    thoughts, steps = watch_steps(watch)
    assert steps[-1].terminated
    assert [watch.driver.names[thought.action] for thought in thoughts][-1] == "meta-exit"


def test_a_plan_shown_is_what_the_option_then_does(clutter):
    watch = Watch(open_driver("planner", clutter), Gate(None))
    plans, met = [], []

    def note(step: Step | None) -> None:
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


def test_a_preview_does_not_disturb_the_option_that_runs(clutter):
    plain, asked = (Watch(open_driver("planner", clutter), Gate(None)) for _ in range(2))
    _, expected = watch_steps(plain)
    steps: list[Step] = []

    def note(step: Step | None) -> None:
        if step is not None:
            steps.append(step)
            for name in asked.previewer.options:
                asked.previewer.preview(name, step.after)

    asked.on_change = note
    asked.run(1)
    assert [step.after for step in steps] == [step.after for step in expected]


def test_a_preview_that_cannot_start_says_so(clutter):
    previewer = Previewer(clutter)
    env = EscapeRoomEnv(instance=clutter)
    env.reset(seed=0)
    preview = previewer.preview("meta-exit", env.get_state())
    assert preview.problem == "it cannot start here" and len(preview.states) == 1


def test_the_gate_lets_primitives_and_decisions_through_one_at_a_time(two_buttons):
    gate = Gate(None, paused=True)
    watch = Watch(open_driver("planner", two_buttons), gate)
    thread = threading.Thread(target=watch.run, args=(1,), daemon=True)
    thread.start()

    def settle() -> int:
        before = -1
        while before != watch.primitives:
            before = watch.primitives
            time.sleep(0.15)
        return before

    assert settle() == 0, "paused, nothing runs"
    for count in (1, 2, 3):
        gate.step(primitives=1)
        assert settle() == count
    gate.step(decisions=1)
    settle()
    assert len(watch.decisions) == 1 and watch.primitives == watch.decisions[0].duration
    gate.step(decisions=1)
    settle()
    assert len(watch.decisions) == 2
    gate.pause(False)
    thread.join(20)
    assert not thread.is_alive() and watch.decisions[-1].name == "meta-exit"


def test_stopping_frees_a_driver_that_waits(two_buttons):
    gate = Gate(None, paused=True)
    thread = threading.Thread(target=Watch(open_driver("smdp-dqn", two_buttons), gate).run, daemon=True)
    thread.start()
    time.sleep(0.2)
    gate.stop()
    thread.join(10)
    assert not thread.is_alive()


# --- what can be wrong with a run ------------------------------------------------------------------


def copy(run: Path, to: Path) -> Path:
    to.mkdir()
    for file in run.iterdir():
        if file.is_file():
            (to / file.name).write_bytes(file.read_bytes())
    return to


def test_a_corrupt_checkpoint_gives_one_message(run: Path, two_buttons, tmp_path: Path, capfd):
    folder = copy(run, tmp_path / "run")
    content = (folder / "checkpoint.npz").read_bytes()
    (folder / "checkpoint.npz").write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        open_driver(str(folder), two_buttons)
    assert main(["watch", str(folder), "--no-open", "--port", "0"]) == 2
    assert len(capfd.readouterr().err.strip().splitlines()) == 1


def test_a_folder_that_is_no_run_and_a_name_that_is_no_agent(two_buttons, tmp_path: Path):
    with pytest.raises(FileReadError, match="run.json"):
        open_driver(str(tmp_path), two_buttons)
    with pytest.raises(FileReadError, match="no such run"):
        open_driver("runs/none", two_buttons)
    with pytest.raises(UnknownNameError, match="smdp-dqn"):
        open_driver("smdp-dqm", two_buttons)
    (tmp_path / "run.json").write_text(json.dumps([1]))
    with pytest.raises(CheckpointError, match="does not describe"):
        open_driver(str(tmp_path), two_buttons)


def test_a_run_of_another_room_is_refused_with_the_way_out(run: Path, clutter):
    with pytest.raises(RunMismatchError, match="--load"):
        open_driver(str(run), clutter)
