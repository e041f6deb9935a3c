"""Common spaces of environments with different objects, so that one agent acts in all of them.

Rooms of two rungs have different numbers of buttons, so they differ in rows of objects and in options. The common
spaces hold the rows and actions of both. An object that an environment lacks is an empty row, and an action that it
lacks is masked. A deep-set network ignores absent rows, so its outputs do not change.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from hrl_escape.errors import ActionError, UnsupportedError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete
from hrl_escape.step_info import read_action

_Slot = tuple["str | None", int]
"""An action by its object and its number among the actions on that object."""


class CommonSpaces(NamedTuple):
    """Rows and actions of several environments."""

    rows: tuple[str, ...]  # names of the objects
    about: tuple[str | None, ...] | None
    """Name of each action's object, or None, or None if no action has an object."""


def join_spaces(envs: Sequence[gymnasium.Env]) -> CommonSpaces:
    """Join the rows and actions of all environments, in the order of the environment with most objects.

    Raises:
        UnsupportedError: their observations are not rows with the same columns, or their actions differ in more than
            their objects.
    """
    observations = [_get_rows(env) for env in envs]
    if len({(space.words, space.context) for space in observations}) > 1:
        raise UnsupportedError("the rows of objects of these environments hold different numbers, or other joints")
    rows = _merge([space.rows for space in observations])
    if not all(isinstance(env.action_space, PointingDiscrete) for env in envs):
        if len({repr(env.action_space) for env in envs}) > 1:
            raise UnsupportedError("the environments have different actions: "
                                   + ", ".join(str(env.action_space) for env in envs))
        return CommonSpaces(rows, None)
    actions = [_list_places(env.action_space.about) for env in envs]  # type: ignore[attr-defined]
    unlike = [{place if place[0] not in rows else place[1] for place in places} for places in actions]
    if any(kind != unlike[0] for kind in unlike):
        raise UnsupportedError("the environments have different primitives or kinds of options, so an agent "
                               "cannot act in both")
    return CommonSpaces(rows, tuple(name for name, _ in _merge(actions)))


def _get_rows(env: gymnasium.Env) -> ObjectsBox:
    if not isinstance(env.observation_space, ObjectsBox):
        raise UnsupportedError("common spaces need rows of objects, observation='objects', not "
                               f"{env.observation_space}")
    return env.observation_space


def _list_places(about: Sequence[str | None]) -> tuple[_Slot, ...]:
    seen: Counter[str | None] = Counter()
    places = []
    for name in about:
        places.append((name, seen[name]))
        seen[name] += 1
    return tuple(places)


def _merge(parts: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
    longest_first = sorted(parts, key=len, reverse=True)
    return tuple(dict.fromkeys(item for part in longest_first for item in part))


class CommonSpacesEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper that gives one of the joined environments the common spaces; missing rows are empty, actions masked."""

    def __init__(self, env: gymnasium.Env, rows: Sequence[str], about: Sequence[str | None] | None) -> None:
        RecordConstructorArgs.__init__(self, rows=list(rows), about=None if about is None else list(about))
        super().__init__(env)
        own = _get_rows(env)
        self._shape, self._words = (len(own.rows), len(own.words)), len(own.words)
        self._places, self._count = [list(rows).index(name) for name in own.rows], len(rows)

        def extend(bound: NDArray[Any]) -> NDArray[Any]:
            cut = len(own.rows) * len(own.words)  # all rows have the same bounds
            return np.concatenate([np.tile(bound[: len(own.words)], len(rows)), bound[cut:]])

        self.observation_space = ObjectsBox(extend(own.low), extend(own.high), rows, own.words)
        self._actions: NDArray[np.int64] | None = None
        if about is not None:
            mine, every = _list_places(env.action_space.about), _list_places(about)  # type: ignore[attr-defined]
            self._actions = np.array([mine.index(place) if place in mine else -1 for place in every])
            self.action_space = PointingDiscrete(len(every), about)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; observation and action mask are in the common spaces."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._show(observation), self._mask(info)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take an action of the common space.

        Raises:
            ActionError: this environment lacks the action.
        """
        if self._actions is not None:
            known = self._actions[read_action(action, len(self._actions))]
            if known < 0:
                raise ActionError(action, len(self._actions))
            action = int(known)
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._show(observation), reward, terminated, truncated, self._mask(info)

    def _show(self, observation: NDArray[Any]) -> NDArray[Any]:
        cut = self._shape[0] * self._shape[1]
        rows = np.zeros((self._count, self._words), observation.dtype)
        rows[self._places] = observation[:cut].reshape(self._shape)
        return np.concatenate([rows.ravel(), observation[cut:]])

    def _mask(self, info: dict[str, Any]) -> dict[str, Any]:
        if self._actions is None:
            return info
        mask = np.asarray(info["action_mask"])[self._actions] * (self._actions >= 0)
        return {**info, "action_mask": mask.astype(np.int8)}
