"""The messages on the page "Troubleshooting" are the messages that the package prints."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import hrl_escape
from hrl_escape import OptionsEnv, RoomConfig, generate, make_env, make_vec, train
from hrl_escape.agents import AgentSpec, WeightsAndBiases
from hrl_escape.cli import main
from hrl_escape.env import ObstaclesConfig, ShapeConfig
from hrl_escape.errors import EscapeError

PAGE = Path(__file__).parents[2] / "docs/troubleshooting.md"


def make_room() -> gymnasium.Env:
    return gymnasium.make("hrl_escape/PaperTwoButton-v1", observation="features")


def step_before_reset() -> None:
    make_room().unwrapped.step(0)


def take_unknown_action() -> None:
    env = make_room().unwrapped
    env.reset(seed=0)
    env.step(17)


def misspell_preset() -> None:
    make_env("cluter")


def misspell_agent() -> None:
    AgentSpec.parse("smdp-dnq")


def give_impossible_width() -> None:
    RoomConfig(room=ShapeConfig(width=1.0))


def fill_the_room() -> None:
    generate(RoomConfig(room=ShapeConfig(width=6, depth=6), obstacles=ObstaclesConfig(count=60)), seed=0)


def step_fresh_rooms_in_a_batch() -> None:
    make_vec("clutter#*", num_envs=4)


def train_options_only_with_primitives() -> None:
    train("smdp-dqn", OptionsEnv(make_room()), primitives=100)


def evaluate_on_another_observation() -> None:
    other = gymnasium.make("hrl_escape/PaperTwoButton-v1", observation="state")
    train("dqn", make_room(), eval_env=other, primitives=100)


def wrap_rewards_above_options() -> None:
    options = OptionsEnv(make_room(), include_primitives=False)
    train("smdp-dqn", gymnasium.wrappers.TransformReward(options, lambda reward: reward / 100), primitives=100)


def train_on_velocities() -> None:
    train("dqn", gymnasium.make("hrl_escape/EscapeRoomContinuous-v1"), primitives=100)


def change_the_seed_in_a_folder() -> None:
    for seed in (0, 1):
        train("q-learning", make_room(), primitives=50, seed=seed, out="run", eval_episodes=0)


def log_without_the_extra() -> None:
    train("q-learning", make_room(), primitives=50, out="logged", callbacks=[WeightsAndBiases()])


class WithoutDiscount(gymnasium.Wrapper):
    """An environment of options that reports durations and no rewards."""

    def step(self, action: np.int64) -> tuple:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, info | {"duration": 3}


def leave_out_the_discount() -> None:
    train("q-learning", WithoutDiscount(make_room()), primitives=50)


def use_a_command_of_0_3() -> None:
    with contextlib.redirect_stderr(io.StringIO()) as printed, contextlib.suppress(SystemExit):
        main(["room", "--preset", "clutter", "--seed", "3"])
    raise EscapeError(printed.getvalue())


FAULTS: dict[str, Callable[[], None]] = {
    "ResetNeededError": step_before_reset,
    "ActionError": take_unknown_action,
    "UnknownNameError, preset": misspell_preset,
    "UnknownNameError, agent": misspell_agent,
    "ConfigError": give_impossible_width,
    "GenerationError": fill_the_room,
    "ConfigError, batch": step_fresh_rooms_in_a_batch,
    "AgentSettingsError, options": train_options_only_with_primitives,
    "AgentSettingsError, eval_env": evaluate_on_another_observation,
    "wrapper": wrap_rewards_above_options,
    "UnsupportedSpaceError": train_on_velocities,
    "RunMismatchError": change_the_seed_in_a_folder,
    "MissingExtraError": log_without_the_extra,
    "StepContractError": leave_out_the_discount,
    "0.3": use_a_command_of_0_3,
}


def show(text: str) -> str:
    """A message as one line, without what differs between runs and machines."""
    return re.sub(r"\s+", " ", re.sub(r"/[^\s'\"]+/", ".../", text)).strip(" '\"")


def list_shown() -> list[str]:
    return [show(block) for block in re.findall(r"```text\n(.+?)```", PAGE.read_text(encoding="utf-8"), re.S)]


@pytest.mark.nightly_for("GenerationError")
@pytest.mark.parametrize("name", FAULTS)
def test_a_message_on_the_page_is_the_message_of_the_package(
        name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    if name == "MissingExtraError":
        monkeypatch.setitem(__import__("sys").modules, "wandb", None)
    with pytest.raises(EscapeError) as caught:
        FAULTS[name]()
    message = show(str(caught.value))
    assert [shown for shown in list_shown() if all(part.strip() in message for part in shown.split("..."))], message


def test_every_message_on_the_page_has_a_fault():
    assert len(list_shown()) == len(FAULTS)
    assert hrl_escape.__version__
