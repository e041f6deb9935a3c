"""Other libraries find the mask, the duration k and gamma^k of a decision where `docs/third_party.md` says."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import (
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    RecordEpisodeStatistics,
    RescaleObservation,
    TimeAwareObservation,
    TimeLimit,
    TransformObservation,
)

from benchmarks.third_party import LIBRARIES
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.options import OptionsEnv

ROOT = Path(__file__).parents[2]
GAMMA = 0.9
KEYS = ("duration", "discount", "discounted_reward", "action_mask")


def make_env(horizon: int = 40, **arguments: Any) -> OptionsEnv:
    """A room with options, whose exit is masked until its buttons are on."""
    config = dataclasses.replace(get_preset("paper-two-button"), horizon=horizon)
    room = EscapeRoomEnv(config, observation="features")
    return OptionsEnv(room, discount=GAMMA, discounted_reward=True, **arguments)


class Decision(NamedTuple):
    """What an agent over options needs of one decision."""

    observation: Any
    action: int
    reward: float
    next_observation: Any
    terminated: bool
    over: bool
    info: dict[str, Any]


def play(seeds: list[int | None], actions: list[int], **arguments: Any) -> list[Decision]:
    """Decisions in episodes one after another, the first action at the first state; legal or not."""
    env, made, remaining = make_env(**arguments), [], iter(actions)
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            action = next(remaining, None)
            if action is None:
                return made
            reached, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            made.append(Decision(observation, action, float(reward), reached, terminated, over, info))
            observation = reached
    return made


# --- Gymnasium ----------------------------------------------------------------------------------


WRAPPERS = {
    "FlattenObservation": FlattenObservation,
    "FrameStackObservation": lambda env: FrameStackObservation(env, 3),
    "NormalizeObservation": NormalizeObservation,
    "RecordEpisodeStatistics": RecordEpisodeStatistics,
    "RescaleObservation": lambda env: RescaleObservation(env, np.float32(0), np.float32(1)),
    "TimeAwareObservation": lambda env: TimeAwareObservation(TimeLimit(env, 100)),
    "TransformObservation": lambda env: TransformObservation(env, lambda seen: 2 * seen, env.observation_space),
}


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers_of_gymnasium_above_options_change_no_duration_and_no_discount(name):
    env, actions = WRAPPERS[name](make_env()), [7, 0, 6, 8]
    _, first = env.reset(seed=4)
    np.testing.assert_array_equal(first["action_mask"], make_env().reset(seed=4)[1]["action_mask"])
    for decision in play([4], actions):
        _, reward, terminated, truncated, info = env.step(decision.action)
        assert (reward, terminated, terminated or truncated) == (decision.reward, decision.terminated, decision.over)
        for key in KEYS:
            np.testing.assert_array_equal(info[key], decision.info[key])


# --- Stable-Baselines3 --------------------------------------------------------------------------


def test_dqn_of_stable_baselines3_learns_smdp_targets_from_a_buffer_that_keeps_discounts():
    """Its DQN multiplies by `discounts` of a batch where the buffer gives them, as for n-step returns."""
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.buffers import ReplayBuffer

    class OptionsBuffer(ReplayBuffer):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            self.discounts = np.ones((self.buffer_size, self.n_envs), np.float32)

        def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: Any) -> None:
            self.discounts[self.pos] = [info["discount"] for info in infos]
            super().add(obs, next_obs, action, reward, done, infos)

        def _get_samples(self, batch_inds: Any, env: Any = None) -> Any:
            batch = super()._get_samples(batch_inds, env)
            return batch._replace(discounts=self.to_torch(self.discounts[batch_inds, 0].reshape(-1, 1)))

    model = sb3.DQN("MlpPolicy", make_env(), seed=0, device="cpu", learning_starts=1_000, gamma=GAMMA,
                    replay_buffer_class=OptionsBuffer, policy_kwargs={"net_arch": [8]}, batch_size=64)
    model.learn(50)
    buffer = model.replay_buffer
    k = np.log(buffer.discounts[:50]) / np.log(GAMMA)
    assert k.max() > 5 and np.allclose(k, k.round(), atol=1e-3)
    primitives_only = (1 - GAMMA**k) / (1 - GAMMA)  # cost of k primitives; an escape pays 100 more
    assert np.isclose(buffer.rewards[:50], -primitives_only, atol=1e-3).sum() > 40
    whole = buffer._get_samples(np.arange(50))
    buffer.sample = lambda size, env=None: whole
    with torch.no_grad():
        following = model.q_net_target(whole.next_observations).amax(1, keepdim=True)
        target = whole.rewards + torch.tensor(GAMMA**k, dtype=torch.float32) * (1 - whole.dones) * following
        value = model.q_net(whole.observations).gather(1, whole.actions.long())
        expected = torch.nn.functional.smooth_l1_loss(value, target).item()
    model.train(gradient_steps=1)
    assert model.logger.name_to_value["train/loss"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.nightly
def test_maskable_ppo_of_sb3_contrib_chooses_by_the_mask_in_info():
    contrib = pytest.importorskip("sb3_contrib")
    from stable_baselines3.common.monitor import Monitor

    infos: list[dict[str, Any]] = []

    def note(scope: dict[str, Any], _: Any) -> bool:
        infos.extend(dict(info) for info in scope["infos"])
        return True

    model = contrib.MaskablePPO("MlpPolicy", Monitor(make_env(horizon=400, include_primitives=False)), seed=0,
                                device="cpu", n_steps=64, batch_size=64, n_epochs=1, policy_kwargs={"net_arch": [8]})
    model.learn(64, callback=note)
    masks, actions = model.rollout_buffer.action_masks.reshape(64, -1), model.rollout_buffer.actions.reshape(64)
    assert (masks == 0).any(axis=1).sum() > 5
    assert (masks[np.arange(64), actions.astype(int)] == 1).all()
    stays = [step for step in range(63) if "terminal_observation" not in infos[step]]
    assert len(stays) > 30
    for step in stays:
        np.testing.assert_array_equal(masks[step + 1], infos[step]["action_mask"])
    assert all(info["discount"] == pytest.approx(GAMMA ** info["duration"]) for info in infos)
    assert max(info["duration"] for info in infos) > 5


# --- loops of single files and emulation ----------------------------------------------------------


def step_like_cleanrl(envs: SyncVectorEnv, actions: list[int]) -> list[Decision]:
    """Transitions of a single environment, as CleanRL's scripts store them in a buffer.

    They act, keep the observation reached in place of a reset's (`final_obs`, in the step in which the episode ends),
    and log the episode's statistics. The same step's decision is in `final_info`.
    """
    observation, _ = envs.reset(seed=5)
    stored = []
    for action in actions:
        reached, rewards, terminations, truncations, infos = envs.step(np.array([action]))
        over = bool(terminations[0] or truncations[0])
        real = infos["final_obs"] if over else reached
        own = infos["final_info"] if over else infos
        if over:
            assert own["episode"]["l"][0] > 0
        stored.append(Decision(observation[0], action, float(rewards[0]), real[0], bool(terminations[0]), over,
                               {key: own[key][0] for key in KEYS}))
        observation = reached
    return stored


def test_a_loop_like_cleanrls_stores_the_decisions_that_one_environment_makes():
    actions = [6, 7, 0, 8, 1, 7, 6, 0, 7, 6, 1, 7, 6, 7, 8]
    envs = SyncVectorEnv([lambda: RecordEpisodeStatistics(make_env())], autoreset_mode=AutoresetMode.SAME_STEP)
    stored, expected = step_like_cleanrl(envs, actions), play([5, *[None] * 20], actions)
    assert sum(decision.over for decision in expected) >= 2
    assert any(decision.over and decision.info["duration"] > 1 for decision in expected)
    for mine, theirs in zip(expected, stored, strict=True):
        for one, other in zip(mine[:-1], theirs[:-1], strict=True):
            np.testing.assert_allclose(one, other)
        for key in KEYS:
            np.testing.assert_allclose(mine.info[key], theirs.info[key])


class Emulated:
    """The protocol by which PufferLib's emulation drives an environment.

    Observations are copied into a row of a shared array, an action is an element of another. An episode that has ended
    is reset in the next step, whose action is ignored.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        assert isinstance(env.observation_space, gymnasium.spaces.Box)
        assert isinstance(env.action_space, gymnasium.spaces.Discrete)
        self.env, self.over = env, True
        self.observations = np.zeros((1, *env.observation_space.shape), env.observation_space.dtype)
        self.actions = np.zeros(1, np.int32)

    def reset(self, seed: int | None = None) -> dict[str, Any]:
        self.observations[0], info = self.env.reset(seed=seed)
        self.over = False
        return info

    def step(self) -> tuple[float, bool, bool, dict[str, Any]]:
        if self.over:
            return 0.0, False, False, self.reset()
        self.observations[0], reward, terminated, truncated, info = self.env.step(self.actions[0])
        self.over = terminated or truncated
        return float(reward), terminated, truncated, info


def test_an_emulation_like_pufferlibs_sees_the_decisions_that_one_environment_makes():
    actions = [6, 7, 0, 8, 1, 7, 6, 0, 7, 6, 1, 7, 6, 7, 8]
    emulated, expected = Emulated(make_env()), play([5, *[None] * 20], actions)
    emulated.reset(seed=5)
    for decision in expected:
        if emulated.over:
            *_, info = emulated.step()
            assert info["duration"] == 0 and info["discount"] == 1
        np.testing.assert_array_equal(emulated.observations[0], decision.observation)
        emulated.actions[0] = decision.action
        reward, terminated, truncated, info = emulated.step()
        np.testing.assert_array_equal(emulated.observations[0], decision.next_observation)
        assert (reward, terminated, terminated or truncated) == (decision.reward, decision.terminated, decision.over)
        for key in KEYS:
            np.testing.assert_array_equal(info[key], decision.info[key])


# --- the page -------------------------------------------------------------------------------------


def list_rows() -> list[list[str]]:
    """Rows of the page's tables, without their headings."""
    lines = re.findall(r"^\| (.*) \|$", (ROOT / "docs/third_party.md").read_text(encoding="utf-8"), re.MULTILINE)
    return [row.split(" | ") for row in lines if not row.startswith(("library", "environments"))]


def test_every_row_of_the_page_names_tests_that_exist():
    rows = list_rows()
    assert len(rows) == 13
    for row in rows:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", row[-1])
        assert named, row[0]
        for file, test in named:
            assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), f"{row[0]}: {file}::{test}"


@pytest.mark.parametrize("row", list_rows(), ids=lambda row: row[0])
def test_the_versions_on_the_page_are_those_that_are_run(row):
    names = {"MiniGrid, BabyAI": "minigrid", "Box2D (LunarLander)": "box2d", "ALE (Breakout)": "ale-py",
             "Gymnasium-Robotics (PointMaze)": "gymnasium-robotics", "RLlib": "ray[rllib]"}
    if row[1].endswith(" only"):
        pytest.skip("it does not install beside this package")
    nightly = [requirement for library in LIBRARIES.values() for requirement in library.requirements]
    tested = (ROOT / "constraints.txt").read_text(encoding="utf-8").replace("_", "-").splitlines()
    pinned = [*nightly, *(line.split(";")[0] for line in tested)]
    assert f"{names.get(row[0], row[0].lower())}=={row[1]}" in pinned
