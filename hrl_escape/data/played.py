"""Own play in any environment with options: recorded, kept with Minari, and learned from.

    data = record_play(env)                              # asks for an option at every decision
    to_minari(data, namespace="mine")                    # Minari's sets, which make the environment again
    train("smdp-fitted-q", data=from_minari("mine/play-decisions-v1"))

`record_play` keeps the reward of every primitive, so that the data can be read at any discount. A set of Minari keeps
the discounted sums of its decisions, and is read at the discount it was recorded with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import count_actions, make_transition, read_action_mask
from hrl_escape.agents.components.offline import Primitives, RecordedDecisions
from hrl_escape.data.export import import_minari, using_minari_folder
from hrl_escape.data.played_data import PlayedData
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.step_info import ENDINGS, is_discount, read_action, read_option

PlayedChoice: TypeAlias = int | str | None
"""Number or name of an action, or None to end the recording."""
ChoiceRule: TypeAlias = Callable[[Any, Mapping[str, Any]], PlayedChoice]
"""(observation, info) -> choice of the next decision."""


class _Rows:
    """Rows of decisions and primitives while they are recorded."""

    def __init__(self, env: gymnasium.Env) -> None:
        self.env, self._flat = env, self._find_flat(env)
        self._gamma = float(env.get_wrapper_attr("gamma")) if env.has_wrapper_attr("gamma") else 0.99
        self._decisions: list[tuple[Any, ...]] = []
        self._primitives: list[tuple[Any, ...]] = []
        self._trajectory = -1
        self._actions = count_actions(env.action_space, "recorded play")

    @staticmethod
    def _find_flat(env: Any) -> OptionsEnv | None:
        """Return the environment of options if it shows the primitives inside a decision, else None."""
        while type(env).__module__.startswith("gymnasium.wrappers.common"):  # these change nothing
            env = env.env
        shows = isinstance(env, OptionsEnv) and env.level == 0 and isinstance(
            env.env.action_space, gymnasium.spaces.Discrete)
        return env if shows else None

    def begin(self, observation: Any, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._trajectory += 1
        self._seen, self._mask = self._check(observation), read_action_mask(info, self._actions)
        if self._flat is not None:  # without the features of options that OptionsEnv can append
            shape = self._flat.env.observation_space.shape
            self._below = self._seen if shape == self._seen.shape else self._seen[: shape[0]]  # type: ignore[index]  # a Box

    def add(self, action: int, step: tuple[Any, Any, bool, bool, dict[str, Any]]) -> None:
        """Append a decision."""
        made, option = make_transition(self._seen, action, self._mask, step, self._gamma), read_option(step[4])
        observation, last = self._check(made.next_observation), made.terminated or made.truncated
        self._decisions.append((
            self._seen, action, self._mask, made.reward, made.summed_reward, made.duration, made.discount, observation,
            made.next_action_mask, made.terminated, last, self._trajectory,
            0 if option is None else ENDINGS.index(option["ended"])))
        self._seen, self._mask = observation, made.next_action_mask
        steps = () if self._flat is None else self._flat.last_steps
        for number, inner in enumerate(steps, 1):
            reached, is_last = np.asarray(inner.observation), number == len(steps)
            self._primitives.append((self._below, int(inner.action), sum(inner.rewards), reached, made.terminated and
                                     is_last, last and is_last, self._trajectory, action, number == 1))
            self._below = reached

    def cut(self) -> None:
        """End the trajectory within an episode."""
        for rows, kind in ((self._decisions, RecordedDecisions), (self._primitives, Primitives)):
            place = kind._fields.index("last")
            if rows:
                rows[-1] = (*rows[-1][:place], True, *rows[-1][place + 1:])

    def make(self, name: str) -> PlayedData:
        """Return the data so far."""
        if not self._decisions:
            raise UnsupportedError("nothing was recorded: no decision was made")
        return PlayedData(name, self.env, self._gamma, _stack(RecordedDecisions, self._decisions),
                          _stack(Primitives, self._primitives) if self._primitives else None)

    def _check(self, observation: Any) -> NDArray[Any]:
        array = np.asarray(observation)
        if array.dtype == object or array.shape != self.env.observation_space.shape:
            raise UnsupportedError(f"observations of {self.env.observation_space} are no arrays: apply a wrapper such "
                                   "as gymnasium.wrappers.FlattenObservation below OptionsEnv, or select one part")
        return array


def _stack(kind: Any, rows: list[tuple[Any, ...]]) -> Any:
    """Return rows as columns of a kind of data."""
    types = {"action": np.int64, "mask": np.bool_, "next_mask": np.bool_, "reward": np.float64, "begins": np.bool_,
             "summed_reward": np.float64, "duration": np.int64, "discount": np.float64, "terminated": np.bool_,
             "last": np.bool_, "trajectory": np.int64, "ended": np.int64, "option": np.int64}
    return kind(*(np.array(column, types.get(name)) for name, column in
                  zip(kind._fields, zip(*rows, strict=True), strict=True)))


def record_play(env: gymnasium.Env, choose: ChoiceRule | None = None, *, episodes: int = 1, seed: int = 0,
                name: str = "play") -> PlayedData:
    """Play episodes in any environment with options, and record them.

    Args:
        env: environment with Discrete actions and observations that are arrays. `OptionsEnv` outermost keeps the
            primitives inside decisions, too.
        choose: returns the number or the name of the next action, or None to end the recording. By default the choice
            is asked for in the terminal or the notebook: each decision shows the environment's text picture, if it has
            one, and the legal actions.
        episodes: number of episodes; the n-th, from 0, resets with `seed + n`.
        seed: 0 or more.
        name: name of the data.

    Returns:
        The recorded decisions. An episode that was ended by choice is a trajectory without an end of the task.

    Raises:
        UnsupportedError: observations are not arrays, or no decision was made.
        UnsupportedSpaceError: the actions are not Discrete.
        ActionError: no such action.
        StepContractError: a step violates the contract of `info`, see `make_transition`.
    """
    rows, names, choose = _Rows(env), _list_names(env), choose or _Question(env)
    for number in range(episodes):
        observation, info = env.reset(seed=seed + number)
        rows.begin(observation, info)
        is_over = False
        while not is_over:
            action = choose(observation, info)
            if action is None:
                rows.cut()
                return rows.make(name)
            index = names.index(action) if action in names else read_action(action, len(names))
            step = env.step(index)
            observation, _, terminated, truncated, info = step
            rows.add(index, step)
            is_over = terminated or truncated
    return rows.make(name)


def _list_names(env: gymnasium.Env) -> tuple[str, ...]:
    if env.has_wrapper_attr("action_names"):
        return tuple(env.get_wrapper_attr("action_names"))
    return tuple(map(str, range(count_actions(env.action_space, "recorded play"))))


class _Question:
    """Rule that asks a person in the terminal."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._env, self._names = env, _list_names(env)

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> PlayedChoice:
        picture = self._env.render() if self._env.render_mode is not None else None
        print(picture if isinstance(picture, str) else observation)
        mask = info.get("action_mask")
        legal = range(len(self._names)) if mask is None else np.flatnonzero(mask).tolist()
        print(", ".join(f"{number} {self._names[number]}" for number in legal))
        while True:
            try:
                answer = input("action, or q to end: ").strip()
            except EOFError:
                return None
            if answer == "q":
                return None
            number = self._names.index(answer) if answer in self._names else answer
            if str(number).isdecimal() and int(number) in legal:
                return int(number)
            print(f"{answer!r} is none of these actions")


# --- Minari ------------------------------------------------------------------------------------


def from_minari(dataset: Any, folder: str | PathLike[str] | None = None, env: gymnasium.Env | None = None
                ) -> PlayedData:
    """Read a set of Minari for `train(data=...)`.

    Args:
        dataset: id such as `mine/play-decisions-v1`, or a `MinariDataset`. Sets of decisions have `duration` and
            `discounted_reward` among their infos, as `to_minari` writes them, and Minari's
            `DataCollector(env, record_infos=True)` over an `OptionsEnv`. Others are read as primitives.
        folder: folder of data sets, as `MINARI_DATASETS_PATH`, or None for Minari's default.
        env: environment for tests; by default the one that the set makes again. That imports the code which the set
            names, so read sets of people you trust.

    Raises:
        MissingExtraError: Minari is not installed.
        ConfigError: no such data set.
        UnsupportedError: observations are not arrays, or the set has no environment.
        UnsupportedSpaceError: the actions of the environment are not Discrete.
    """
    minari = import_minari()
    with using_minari_folder(folder):
        if isinstance(dataset, str):
            try:
                dataset = minari.load_dataset(dataset)
            except (FileNotFoundError, ValueError) as error:
                raise ConfigError("dataset", dataset, "the id of a local data set; `minari list local` shows them"
                                  ) from error
        name = dataset.spec.dataset_id
        if env is None and dataset.env_spec is None:
            raise UnsupportedError(f"{name} keeps no environment: give from_minari(..., env=...)")
        test_env: gymnasium.Env = dataset.recover_environment() if env is None else env
        episodes = [episode for episode in dataset.iterate_episodes() if len(episode.actions)]
    if not episodes or not isinstance(episodes[0].observations, np.ndarray):
        raise UnsupportedError(f"{name} has no episodes whose observations are arrays")
    actions = count_actions(test_env.action_space, "recorded play")
    parts = [_read_episode(episode, number, actions) for number, episode in enumerate(episodes)]
    if isinstance(parts[0], RecordedDecisions):
        decisions = RecordedDecisions(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
        return PlayedData(name, test_env, _find_gamma(decisions, name), decisions, None)
    primitives = Primitives(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    return PlayedData(name, test_env, 0.99, None, primitives, "primitives")


def _read_episode(episode: Any, number: int, actions: int) -> RecordedDecisions | Primitives:
    """Return the rows of an episode."""
    seen, taken = episode.observations, np.asarray(episode.actions, np.int64)
    count, infos = len(taken), episode.infos or {}
    terminated = np.asarray(episode.terminations, np.bool_)
    last = np.arange(count) == count - 1
    rewards, trajectory = np.asarray(episode.rewards, np.float64), np.full(count, number, np.int64)
    if not {"duration", "discount", "discounted_reward"} <= infos.keys():
        option = np.asarray(infos.get("option", -np.ones(count + 1)), np.int64)[1:]
        begins = np.asarray(infos.get("begins", np.ones(count + 1)), np.bool_)[1:]
        return Primitives(seen[:-1], taken, rewards, seen[1:], terminated, last, trajectory, option, begins)
    mask = np.asarray(infos.get("action_mask", np.ones((count + 1, actions)))) != 0
    summed = np.asarray(infos.get("summed_reward", np.append(0.0, rewards)), np.float64)[1:]
    return RecordedDecisions(
        seen[:-1], taken, mask[:-1], np.asarray(infos["discounted_reward"], np.float64)[1:], summed,
        np.asarray(infos["duration"], np.int64)[1:], np.asarray(infos["discount"], np.float64)[1:], seen[1:], mask[1:],
        terminated, last, trajectory, _read_endings(infos, count))


def _read_endings(infos: Mapping[str, Any], count: int) -> NDArray[np.int64]:
    """Return how options ended, as indices into `ENDINGS`."""
    if "ended" in infos:
        return np.asarray(infos["ended"], np.int64)[1:]
    ended = infos.get("option", {}).get("ended", [b"reached"] * (count + 1))
    words = [each.decode() if isinstance(each, bytes) else str(each) for each in ended[1:]]
    return np.array([ENDINGS.index(word) if word in ENDINGS else 0 for word in words], np.int64)


def _find_gamma(decisions: RecordedDecisions, name: str) -> float:
    """Return the discount per primitive that all decisions agree on.

    Raises:
        UnsupportedError: they disagree.
    """
    longest = int(np.argmax(decisions.duration))
    gamma = round(float(decisions.discount[longest] ** (1 / decisions.duration[longest])), 9)
    if not all(is_discount(float(discount), gamma, int(duration)) for discount, duration in
               zip(decisions.discount, decisions.duration, strict=True)):
        raise UnsupportedError(f"decisions of {name} were recorded with several discounts")
    return gamma
