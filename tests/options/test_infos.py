"""What `info` holds: the same in equal runs, of the same form at every step, and what recorders of others can take."""

import copy
import importlib.util
import sys
import types
from dataclasses import FrozenInstanceError

import gymnasium
import minari
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.save_video import save_video
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from gymnasium.wrappers import RecordVideo, RenderCollection
from torchrl.envs.libs.gym import GymWrapper, default_info_dict_reader

from hrl_escape.agents import train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import PRESETS, make_env_name
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.route import PlanningSummary
from hrl_escape.sets.sequence import SequenceEnv
from tests.covering import thin
from tests.env.test_ranges import VARIED

IDS = [f"hrl_escape/{name}{suffix}-v1" for suffix in ("", "Options")
       for name in ("EscapeRoom", *map(make_env_name, PRESETS))]
IDS += ["hrl_escape/EscapeRoomContinuous-v1", "hrl_escape/Ladder-v1"]
TWO, BEST = "hrl_escape/PaperTwoButtonOptions-v1", 9  # primitives of the first option


def play(name, steps=12):
    """Everything that an environment returns in a run of random legal actions."""
    env = gymnasium.make(name, disable_env_checker=True)
    if "PushBlock" in name:
        steps = 2
    observation, info = env.reset(seed=3)
    env.action_space.seed(3)
    seen = [(copy.deepcopy(observation), copy.deepcopy(info))]
    for _ in range(steps):
        mask = info.get("action_mask")
        *step, info = env.step(env.action_space.sample(mask) if mask is not None else env.action_space.sample())
        seen.append((*copy.deepcopy(step), copy.deepcopy(info)))
        if step[2] or step[3]:
            break
    env.close()
    return seen


@pytest.mark.nightly_for("hrl_escape/PuddleWorldOptions-v1")
@pytest.mark.parametrize("name", thin(IDS, 14, 4))
def test_equal_runs_give_equal_infos(name):
    """In the second run all plans are in the planner's cache."""
    assert data_equivalence(play(name), play(name), exact=True)


def test_the_checker_of_gymnasium_takes_options_alone():
    check_env(gymnasium.make(TWO, include_primitives=False, disable_env_checker=True), skip_render_check=True)


def describe(value):
    if isinstance(value, dict):
        return {name: describe(part) for name, part in value.items()}
    return (value.shape, str(value.dtype)) if isinstance(value, (np.ndarray, np.generic)) else type(value)


def test_infos_have_one_form_at_every_reset_and_step_of_rooms_that_differ():
    """The rooms have two to five buttons."""
    env = gymnasium.make("hrl_escape/EscapeRoomOptions-v1", config=VARIED)
    forms, counts = [], set()
    env.action_space.seed(0)
    for seed in range(5):
        _, info = env.reset(seed=seed, options={"instance_seed": seed})
        counts.add(len(env.unwrapped.instance.targets))
        forms.append(describe(info))
        for _ in range(2):
            *_, info = env.step(env.action_space.sample(info["action_mask"]))
            forms.append(describe(info))
    assert len(counts) > 1 and all(form == forms[0] for form in forms)
    assert {name: form for name, form in forms[0]["option"].items() if form is not str} == {"index": ((), "int64")}
    assert all(form in (bool, int) or name == "option" or isinstance(form, tuple) for name, form in forms[0].items())
    env.close()


def test_rewards_of_primitives_are_given_if_asked_for_and_their_sums_always():
    for tracing in (False, True):
        env = gymnasium.make(TWO, trace=tracing, discounted_reward=True, discount=0.9)
        env.reset(seed=0)
        _, reward, _, _, info = env.step(6)
        assert info.get("rewards") == ((-1.0,) * BEST if tracing else None)
        assert env.get_wrapper_attr("last_rewards") == (-1.0,) * BEST
        assert info["summed_reward"] == -BEST and reward == info["discounted_reward"] == pytest.approx(
            -(1 - 0.9**BEST) / 0.1)


# --- planning -----------------------------------------------------------------------------------


def test_planning_is_reported_by_an_attribute_and_not_in_infos():
    env = OptionsEnv(EscapeRoomEnv("paper-two-button"))
    assert env.planning_report == env.planning_total == PlanningSummary()
    env.reset(seed=0)
    total = PlanningSummary()
    for action in (6, 0, 7):
        info = env.step(action)[4]
        total += env.planning_report
        assert not {"planner_seconds", "planner_calls", "cache_hits", "replans"} & (info.keys() | info["option"].keys())
    assert env.planning_report.planner_calls == 1 and env.planning_report.planner_seconds > 0
    assert env.planning_total == total and total.planner_calls == 2
    with pytest.raises(FrozenInstanceError):
        env.planning_report.replans = 1


@pytest.mark.parametrize("kind", [SyncVectorEnv, pytest.param(AsyncVectorEnv, marks=pytest.mark.nightly)])
def test_a_vector_environment_gives_the_reports_of_its_environments_in_other_processes_too(kind):
    rooms = kind([lambda: gymnasium.make(f"hrl_escape:{TWO}")] * 2)  # torchrl makes Python spawn new processes
    try:
        rooms.reset(seed=0)
        rooms.step(np.array([0, 6]))
        assert [report.planner_calls for report in rooms.get_attr("planning_report")] == [0, 1]
    finally:
        rooms.close()


def test_training_counts_the_planner_calls_of_all_levels_and_floors():
    def make():
        return OptionsEnv(EscapeRoomEnv("paper-one-button"), include_primitives=False)

    env = SequenceEnv(make(), then=[make()])
    result = train("random-options", env, decisions=12, primitives=10_000, eval_episodes=0)
    totals = [floor.planning_total for floor in env.parts]
    assert result.planner_calls == sum(total.planner_calls for total in totals)
    assert all(total.planner_calls for total in totals)
    assert result.planner_seconds == pytest.approx(sum(total.planner_seconds for total in totals))


# --- discounts ----------------------------------------------------------------------------------


def test_training_sets_the_discount_of_options_on_every_floor_to_its_agents():
    def make():
        return OptionsEnv(EscapeRoomEnv("paper-one-button"), include_primitives=False, discount=0.99)

    env, settings = SequenceEnv(make(), then=[make()]), {"gamma": 0.9, "epsilon_start": 1.0}
    result = train("smdp-q-learning", env, primitives=200, settings=settings, eval_episodes=0)
    assert [floor.gamma for floor in env.parts] == [0.9, 0.9] and result.agent.gamma == 0.9
    _, info = env.reset(seed=0)
    info = env.step(int(np.argmax(info["action_mask"])))[4]
    assert info["duration"] > 1 and info["discount"] == 0.9 ** info["duration"]


# --- recorders ----------------------------------------------------------------------------------


@pytest.fixture
def collector(tmp_path, monkeypatch):
    """Minari's `DataCollector`, with `jax.tree_util` from torch where jax, which it needs for one call, is absent."""
    if importlib.util.find_spec("jax") is None:
        tree = types.ModuleType("jax.tree_util")
        tree.tree_map = torch.utils._pytree.tree_map
        jax = types.ModuleType("jax")
        jax.tree_util = tree
        monkeypatch.setitem(sys.modules, "jax", jax)
        monkeypatch.setitem(sys.modules, "jax.tree_util", tree)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return minari.DataCollector


def test_minari_records_the_infos_of_options(collector):
    env = collector(gymnasium.make(TWO), record_infos=True)
    rng, seen = np.random.default_rng(0), []
    for episode in range(2):
        _, info = env.reset(seed=episode + 2**63)
        seen.append([info])
        is_over = False
        while not is_over:
            *_, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
            is_over = terminated or truncated or len(seen[-1]) == 12
            seen[-1].append(info)
    data = env.create_dataset("options/test-v0", eval_env=gymnasium.make(TWO), ref_min_score=0.0, ref_max_score=1.0)
    for episode, infos in zip(data.iterate_episodes(), seen, strict=True):
        for name in ("duration", "discount", "summed_reward", "discounted_reward", "action_mask", "pressed",
                     "also_pressed"):
            np.testing.assert_array_equal(episode.infos[name], np.stack([info[name] for info in infos]))
        names = [info["option"]["name"].encode() for info in infos]
        assert episode.infos["option"]["name"].tolist() == names
    env.close()


@pytest.mark.nightly
def test_torchrl_reads_durations_and_discounts_from_infos():
    names = ["duration", "discount", "summed_reward", "discounted_reward", "action_mask", "pressed"]
    env = GymWrapper(gymnasium.make(TWO, discount=0.9)).set_info_dict_reader(default_info_dict_reader(names))
    env.set_seed(0)
    step = env.step(env.reset().set("action", env.action_spec.zero().index_fill(-1, torch.tensor(6), 1)))["next"]
    assert step["duration"].item() == BEST and step["discount"].item() == pytest.approx(0.9**BEST)
    assert step["summed_reward"].item() == step["reward"].item() == -BEST and step["pressed"].tolist() == [1, 0]


# --- films --------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_nine_primitives_give_nine_frames(tmp_path):
    """Besides the one of the reset. Frames are those of the room after each primitive."""
    small = {"render_size": (64, 48)}
    flat = gymnasium.make("hrl_escape/PaperTwoButton-v1", render_mode="rgb_array", **small)
    flat.reset(seed=0)
    plan = get_planner(flat.unwrapped.instance).plan(flat.unwrapped.get_state(), "press-button-1")
    frames = [flat.render()]
    for primitive in plan.primitives:
        flat.step(primitive)
        frames.append(flat.render())
    assert len(frames) == 1 + BEST
    env = gymnasium.make(TWO, render_mode="rgb_array_list", **small)
    env.reset(seed=0)
    assert env.step(6)[4]["duration"] == BEST
    filmed = env.render()
    np.testing.assert_array_equal(filmed, frames)
    save_video(filmed, str(tmp_path / "saved"), fps=10, episode_trigger=lambda episode: True)
    assert list((tmp_path / "saved").glob("*.mp4"))

    above = RecordVideo(gymnasium.make(TWO, render_mode="rgb_array_list", **small), str(tmp_path), disable_logger=True)
    above.reset(seed=0)
    above.step(6)
    np.testing.assert_array_equal(above.render(), frames)
    below = RecordVideo(EscapeRoomEnv("paper-two-button", render_mode="rgb_array", **small), str(tmp_path),
                        name_prefix="below", disable_logger=True)
    env = OptionsEnv(below)
    env.reset(seed=0)
    env.step(6)
    np.testing.assert_array_equal(below.recorded_frames, frames)
    collected = OptionsEnv(RenderCollection(EscapeRoomEnv("paper-two-button", render_mode="rgb_array", **small)))
    collected.reset(seed=0)
    collected.step(6)
    np.testing.assert_array_equal(collected.render(), frames)
    for each in (flat, above, env, collected):
        each.close()
