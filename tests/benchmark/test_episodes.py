"""Recorded episodes are what happened, and hold what a page needs to draw it."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.run_results import get_run_folder, read_episodes
from hrl_escape.env.pictures.moving_map import make_frames
from hrl_escape.env.presets import get_preset
from hrl_escape.env.primitives import make_action_table
from hrl_escape.env.puzzles.lights_out import LightsOutConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import FileReadError, UnknownNameError, UnsupportedError
from hrl_escape.files import write_json
from hrl_escape.options import OptionsEnv
from hrl_escape.sets.places import RunPlace
from tests.benchmark.small import SCHEMATIC, SMALL


def record(name: str, seed: int = 3):
    instance = generate(SCHEMATIC, 0)
    env, recorder = make_agent_env(AgentSpec(name), instance, "features")
    agent = make_agent(name, env.observation_space, env.action_space, 0)
    return instance, env, recorder, record_episode(agent, env, seed).to_json()


@pytest.mark.parametrize("name", ["random", "random-options"])
def test_frames_replay_to_the_same_states_in_a_fresh_environment(name: str):
    """Durations, return and states of the record, against a flat environment driven by the recorded states' actions."""
    instance, _, recorder, episode = record(name)
    frames = episode["frames"]
    assert len(frames["x"]) == len(frames["y"]) == len(frames["heading"]) == episode["primitives"] + 1
    assert sum(duration for _, duration, _ in episode["decisions"]) == episode["primitives"]
    bonus = instance.reward.exit if episode["success"] else 0.0
    assert episode["return"] == -episode["primitives"] + bonus
    rules = recorder.env.unwrapped.rules
    for number, (before, after) in enumerate(zip(recorder.states, recorder.states[1:], strict=False)):
        steps = [rules.step(before, action).state for action in range(len(rules.actions))]
        assert after in steps
        assert (frames["x"][number], frames["y"][number]) == (round(before.x, 3), round(before.y, 3))


def test_an_episode_plays_itself_and_leaves_no_recorder():
    """The same states, whether a recorder was there or is put in for the time being, below options or around a room."""
    instance = generate(SCHEMATIC, 0)
    for name in ("random", "random-options"):
        flat = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=instance, observation="features")
        env = OptionsEnv(flat, include_primitives=False) if name == "random-options" else flat
        agent = make_agent(name, env.observation_space, env.action_space, 0)
        episode = record_episode(agent, env, 3)
        assert episode.to_json() == record(name)[3]
        with pytest.raises(UnsupportedError):
            find_recorder(env)
        assert "\n" not in repr(episode) and f"{len(episode.states) - 1} primitives" in repr(episode)
        assert "<iframe" in episode._repr_html_()
    planned = record_episode("oracle", flat)
    assert planned.success and -planned.total + 100 == len(planned.states) - 1
    assert record_episode("search-nearest", env).success
    with pytest.raises(UnknownNameError, match="search-nearest"):
        record_episode("search-nearst", env)
    with pytest.raises(UnsupportedError, match="is not a room"):
        record_episode(agent, gymnasium.make("Taxi-v4"))


def test_decisions_carry_the_names_of_primitives_and_options():
    primitives = set(make_action_table(0).names)
    names = {name for name, _, _ in record("random")[3]["decisions"]}
    assert names and names <= primitives
    chosen = {name for name, _, _ in record("random-options")[3]["decisions"]}
    assert chosen - primitives and chosen - primitives <= {"press-button-1", "press-button-2", "go-to-exit"}


def test_lights_and_exit_change_where_the_room_says():
    instance, _, recorder, episode = record("random-options")
    puzzle = instance.puzzle
    lit, is_open = dict(episode["frames"]["lit"]), dict(episode["frames"]["open"])
    assert episode["success"] and len(lit) > 1 and len(is_open) == 2
    now, opened = [], False
    for number, state in enumerate(recorder.states):
        now, opened = lit.get(number, now), is_open.get(number, opened)
        assert now == [i for i, on in enumerate(puzzle.get_lit(state.puzzle)) if on]
        assert opened == puzzle.is_solved(state.puzzle)


def test_the_arm_ends_at_the_hand():
    instance = generate(get_preset("arm-two-button"), 0)
    env = StateRecorder(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=instance))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        env.step(int(rng.integers(env.action_space.n)))
    rules = env.unwrapped.rules
    for state, points in zip(env.states, make_frames(rules, env.states)["arm"], strict=True):
        forward, left, _ = rules.robot.compute_hand(rules.get_angles(state))
        turned = complex(forward, left) * np.exp(1j * rules.get_heading(state))
        assert points[-1] == pytest.approx((state.x + turned.real, state.y + turned.imag), abs=2e-3)
        lengths = [np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in zip(points, points[1:], strict=False)]
        assert max(lengths) <= instance.robot.link_length + 2e-3


def test_pushed_props_move():
    instance = generate(get_preset("push-block"), 0)
    env = StateRecorder(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=instance))
    env.reset(seed=0)
    for _ in range(3):
        env.step(0)
    frames = make_frames(env.unwrapped.rules, env.states)
    assert len(frames["props"]) == 4 and len(frames["props"][0]) == len(instance.props)
    x, y, _ = frames["props"][0][0]
    assert (x, y) == pytest.approx((instance.props[0].x, instance.props[0].y), abs=0.02)


def test_recording_changes_nothing():
    instance = dataclasses.replace(generate(SCHEMATIC, 0))
    plain = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=instance, observation="features")
    recorded, _ = make_agent_env(AgentSpec("random"), instance, "features")
    first, second = (env.reset(seed=5)[0] for env in (plain, recorded))
    assert np.array_equal(first, second)
    for action in (0, 2, 4, 1):
        assert np.array_equal(plain.step(action)[0], recorded.step(action)[0])


def test_progress_is_the_share_of_the_goals_ancestors_lit_at_best():
    """A chain of four: two are lit, then the last is pressed too early, and progress stays at a half."""
    room = generate(get_preset("four-button-chain"), 0)
    assert room.puzzle.goal_targets and len(room.targets) == 4
    env, _ = make_agent_env(AgentSpec("random-options"), room, "features")
    env.reset(seed=0)
    parents = {child: parent for parent, child in room.puzzle.edges}
    order = [next(target for target in range(4) if target not in parents)]
    while len(order) < 4:
        order.append(next(child for child, parent in parents.items() if parent == order[-1]))
    shares = [env.step(option)[4]["progress"] for option in (order[0], order[1], order[3])]
    assert shares == [0.25, 0.5, 0.5]
    assert env.reset(seed=0)[1]["progress"] == 0


def test_progress_in_a_board_that_must_go_dark_counts_lights_that_are_off():
    lights = LightsOutConfig(rows=4, columns=4, task=4)  # from 1001 in all rows to all off, by six presses
    room = generate(dataclasses.replace(get_preset("lights-out"), puzzle=lights), 0)
    env, _ = make_agent_env(AgentSpec("random-options"), room, "features")
    assert env.reset(seed=0)[1]["progress"] == 0.5
    assert env.step(0)[4]["progress"] == 9 / 16, "two lights go off and one goes on"
    assert env.step(0)[4]["progress"] == 9 / 16, "back again, and the best so far counts"


FORGED = {
    "decisions": ([["press", -1, "reached"]], "decisions[0][1]"),
    "success": ("<b>", "success"),
    "return": ("-12", "return"),
    "primitives": (10**9, "frames.x"),
    "frames": ({}, "frames"),
    "lit": ([[0, []], [10**6, [0]]], "frames.lit"),
    "heading": (["0"], "frames.heading[0]"),
    "arm": ([[]], "frames.arm"),
}
"""Values of a record that are not valid, and what the message names."""


def test_a_record_of_episodes_is_read_as_written_and_a_forged_one_refused(tmp_path: Path):
    run = SMALL.make_runs([RunPlace.of_room(generate(SCHEMATIC, 0))])[0]
    path = get_run_folder(tmp_path, run) / "episodes.json"
    path.parent.mkdir(parents=True)
    episode = json.loads(json.dumps(record("random-options")[3]))
    write_json(path, [episode])
    assert read_episodes(tmp_path, run) == [episode]
    for name, (value, place) in FORGED.items():
        frames = {**episode["frames"], name: value} if name in episode["frames"] else episode["frames"]
        write_json(path, [episode, {**episode, "frames": frames} | ({} if name in frames else {name: value})])
        with pytest.raises(FileReadError, match=re.escape(f"episodes[1].{place}")):
            read_episodes(tmp_path, run)
    for value in ({}, [[]], [{**episode, "more": 1}], [{}]):
        write_json(path, value)
        with pytest.raises(FileReadError, match="damaged"):
            read_episodes(tmp_path, run)
