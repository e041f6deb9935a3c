"""Memory of an episode's decisions, as additional numbers in the rows of the observation `objects`.

The dependencies between buttons are hidden, so the present observation does not show what the agent has tried. A
summary of all decisions in each object's row suffices for deterministic puzzles.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from hrl_escape.errors import UnsupportedError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.options.batched.env import BatchedOptionsEnv, Transitions

MEMORY_WORDS = ("failed", "recent", "rank")
"""Numbers that a memory appends to a row."""


class _Memories:
    """Memories of several episodes, and the rule that updates them.

    The code uses functions that have the same name in `numpy` and `torch`. `space` is the space of observations with
    memory.

    Raises:
        UnsupportedError: observations or actions of another kind.
    """

    def __init__(self, space: gymnasium.Space, actions: gymnasium.Space, count: int, library: Any = np,
                 device: Any = "cpu") -> None:
        if not isinstance(space, ObjectsBox) or not isinstance(actions, PointingDiscrete):
            raise UnsupportedError("a memory of decisions needs rows of objects and actions about them: give it an "
                                   "OptionsEnv over observation='objects'")
        self._module, self._device = library.__name__, device
        self._shape = len(space.rows), len(space.words)
        self._lit, self._present = space.words.index("lit"), space.words.index("present")
        subjects = [space.rows.index(name) if name in space.rows else -1 for name in actions.about]
        self._subjects = library.asarray(subjects, device=device)
        self._rows = library.arange(len(space.rows), device=device)
        ends = np.repeat((1 + np.arange(len(space.rows))) * len(space.words), len(MEMORY_WORDS))
        self.space = ObjectsBox(np.insert(space.low, ends, 0), np.insert(space.high, ends, 1), space.rows,
                                (*space.words, *MEMORY_WORDS))
        rows, sets = (count, len(space.rows)), (count, 1, len(space.rows))
        self._sets, self._failures = self._make(sets, "bool"), self._make(sets, "bool")
        self._used = self._make((count,), "int64")  # number of sets of lit objects that had a failure
        self._lit_now, self._failed = self._make(rows, "bool"), self._make(rows, "bool")
        self._since, self._ranks = self._make(rows, "float64") + np.inf, self._make(rows, "float64")
        self._most_used = 0  # maximum over episodes

    @property
    def _library(self) -> Any:
        """Return `numpy` or `torch`, looked up by name, because modules cannot be pickled."""
        return sys.modules[self._module]

    def _make(self, shape: tuple[int, ...], dtype: str) -> Any:
        return self._library.zeros(shape, dtype=getattr(self._library, dtype), device=self._device)

    def begin(self, which: Any, observation: Any) -> None:
        """Empty the memory of some episodes, bool (count,), which begin with these observations, (count, numbers)."""
        where, begins = self._library.where, which[:, None]
        self._used = where(which, 0, self._used)
        self._failed, self._ranks = self._failed & ~begins, where(begins, 0.0, self._ranks)
        self._since = where(begins, np.inf, self._since)
        self._lit_now = where(begins, self._read_lit(observation), self._lit_now)

    def note(self, which: Any, action: Any, reached: Any, can_fail: bool = True) -> None:
        """Note decisions of some episodes, bool (count,).

        Actions are (count,), observations reached (count, numbers).
        """
        where = self._library.where
        before, after = self._lit_now, where(which[:, None], self._read_lit(reached), self._lit_now)
        about = (self._subjects[where(which, action, 0)][:, None] == self._rows) & which[:, None]
        self._since = where(about, 0.0, self._since + which[:, None])
        if can_fail:
            self._note_failures(before, about & ~after)
        ranks = 1.0 / (1 + before.sum(axis=1, keepdims=True))
        self._ranks = where(after & ~before, ranks, self._ranks)
        self._lit_now = after
        self._failed = (self._find_sets(after)[:, :, None] & self._failures).any(axis=1)

    def _note_failures(self, lit: Any, failed: Any) -> None:
        """Note which rows failed, bool (count, rows). They are stored per set of lit objects."""
        if self._most_used == self._sets.shape[1]:
            self._most_used = int(self._used.max())
        if self._most_used == self._sets.shape[1]:
            self._sets, self._failures = (self._library.concatenate([part, self._library.zeros_like(part)], axis=1)
                                          for part in (self._sets, self._failures))
        self._most_used += 1
        known = self._find_sets(lit)
        free = self._library.arange(self._sets.shape[1], device=self._device) == self._used[:, None]
        place = (known | (free & ~known.any(axis=1)[:, None])) & failed.any(axis=1)[:, None]
        self._used = self._used + (place & ~known).any(axis=1)
        self._sets = self._library.where(place[:, :, None], lit[:, None], self._sets)
        still = self._failures & known[:, :, None]
        self._failures = self._library.where(place[:, :, None], still | failed[:, None], self._failures)

    def _find_sets(self, lit: Any) -> Any:
        """Return where these sets of lit objects, (count, rows), are stored, bool (count, places)."""
        places = self._library.arange(self._sets.shape[1], device=self._device)
        return (self._sets == lit[:, None]).all(axis=2) & (places < self._used[:, None])

    def remember(self, observation: Any) -> Any:
        """Return the observations of all episodes, (count, numbers), with the memory at the end of each row."""
        (rows, words), library = self._shape, self._library
        seen = observation[:, : rows * words].reshape(-1, rows, words)
        memory = library.stack([self._failed + 0.0, 1.0 / (1 + self._since), self._ranks], -1)
        memory = library.asarray(memory, dtype=seen.dtype) * (seen[:, :, self._present, None] > 0)
        joined = library.concatenate([seen, memory], axis=2).reshape(len(seen), -1)
        return library.concatenate([joined, observation[:, rows * words :]], axis=1)

    def _read_lit(self, observation: Any) -> Any:
        """Return which objects are lit, bool (count, rows)."""
        rows, words = self._shape
        return observation[:, : rows * words].reshape(-1, rows, words)[:, :, self._lit] > 0.5

    def state_dict(self) -> dict[str, Any]:
        """Return all memories as NumPy arrays."""
        return {name: np.asarray(self._library.asarray(getattr(self, f"_{name}"), device="cpu")).copy()
                for name in _STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state from `state_dict`."""
        for name in _STATE:
            setattr(self, f"_{name}", self._library.asarray(np.array(state[name]), device=self._device))
        self._most_used = self._sets.shape[1]


_STATE = ("sets", "failures", "used", "lit_now", "failed", "since", "ranks")
_ONE = np.ones(1, np.bool_)


class DecisionMemory(gymnasium.Wrapper, RecordConstructorArgs):
    """Appends to each object's row a summary of the episode's decisions about it.

    | number | meaning |
    |---|---|
    | `failed` | 1 if a decision about it left it unlit while the same objects were lit as now |
    | `recent` | 1 / (1 + n) for n decisions since the last one about it; 0 without one |
    | `rank` | 1 / (1 + n) for n objects lit when it last turned on; 0 if it never did |

    Rows of absent objects stay 0. A decision that ends a trial (`info["trial_ended"]`, see `SequenceEnv`) does not
    count as a failure.

    Args:
        env: an environment with observations in rows of objects and actions with an object each: an `OptionsEnv` over
            `observation="objects"`.

    Raises:
        UnsupportedError: another environment.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._memory = _Memories(env.observation_space, env.action_space, 1)
        self.observation_space = self._memory.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode with an empty memory."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory.begin(_ONE, observation[None])
        return self._memory.remember(observation[None])[0], info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run a decision and note its outcome."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._memory.note(_ONE, np.array([int(action)]), observation[None], not info.get("trial_ended", False))
        return self._memory.remember(observation[None])[0], reward, terminated, truncated, info


class VectorDecisionMemory:
    """Adds the memory of `DecisionMemory` to many rooms; each decides at its own pace.

    Args:
        streams: a `BatchedOptionsEnv` over `observation="objects"`.

    Attributes:
        observation_space: of one room, with memory.
        observation: of all rooms, (rooms, numbers); valid where `is_waiting`.

    Raises:
        UnsupportedError: another environment.
    """

    def __init__(self, streams: BatchedOptionsEnv) -> None:
        import torch  # `DecisionMemory` does not need torch

        self._streams = streams
        self.count, self.device = streams.count, streams.device
        self.action_space = streams.action_space
        self._memory = _Memories(streams.observation_space, streams.action_space, self.count, torch, self.device)
        self.observation_space = self._memory.space
        self.observation: Tensor

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self._streams.gamma

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount per primitive."""
        self._streams.set_option_discount(gamma)

    @property
    def action_mask(self) -> Tensor:
        """Return the legal actions, bool (rooms, actions)."""
        return self._streams.action_mask

    @property
    def is_waiting(self) -> Tensor:
        """Return which rooms take an action at the next step, bool (rooms,)."""
        return self._streams.is_waiting

    def reset(self, seeds: int) -> None:
        """Reset all rooms and empty their memories; room i draws from seed + i."""
        seen = self._streams.reset(seeds)
        self._memory.begin(self.is_waiting | True, seen)
        self.observation = self._memory.remember(seen)

    def step(self, action: Tensor) -> Transitions:
        """Step with the actions of waiting rooms, int64 (rooms,), and note the decisions that ended."""
        ended = self._streams.step(action)
        before = self._memory.remember(ended.observation)
        self._memory.note(ended.where, ended.action, ended.next_observation)
        after = self._memory.remember(ended.next_observation)
        self._memory.begin(ended.where & (ended.terminated | ended.truncated), self._streams.observation)
        self.observation = self._memory.remember(self._streams.observation)
        return ended._replace(observation=before, next_observation=after)

    def make_single_env(self) -> gymnasium.Env:
        """Make a single environment of the same rooms and options, with a memory."""
        return DecisionMemory(self._streams.make_single_env())

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values."""
        return self._streams.describe()

    def state_dict(self) -> dict[str, Any]:
        """Return rooms, running decisions and memories, as arrays."""
        return {"streams": self._streams.state_dict(), "memory": self._memory.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state from `state_dict`, in as many of the same rooms."""
        self._streams.load_state_dict(state["streams"])
        self._memory.load_state_dict(state["memory"])
        self.observation = self._memory.remember(self._streams.observation)
