"""Memory of an episode's decisions, as further numbers in the rows of the observation `objects`.

The dependencies between buttons are hidden, so an agent that sees only the present cannot know what it has tried. This
wrapper adds to each object's row a summary of all decisions so far, which is enough for puzzles without chance.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

MEMORY_WORDS = ("failed", "recent", "rank")
"""Numbers that `DecisionMemory` appends to a row."""


class DecisionMemory(gymnasium.Wrapper, RecordConstructorArgs):
    """Appends to each object's row a summary of the episode's decisions about it.

    | word | meaning |
    |---|---|
    | `failed` | 1 if a decision about it left it unlit when the same objects were lit as now |
    | `recent` | 1 / (1 + n), n decisions since the last one about it; 0 if there was none |
    | `rank` | 1 / (1 + n), n objects lit before it when it last came on; 0 if it never did |

    Rows of absent objects stay 0. A decision that ends a trial (`info["trial_ended"]`, see `SequenceEnv`) fails
    nothing.

    Args:
        env: an environment with observations in rows of objects and actions that say what they are about: an
            `OptionsEnv` over `observation="objects"`.

    Raises:
        UnsupportedError: another environment.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        space, actions = env.observation_space, env.action_space
        if not isinstance(space, ObjectsBox) or not isinstance(actions, PointingDiscrete):
            raise UnsupportedError("a memory of decisions needs rows of objects and actions about them: give it an "
                                   "OptionsEnv over observation='objects'")
        self._shape = len(space.rows), len(space.words)
        self._lit, self._present = space.words.index("lit"), space.words.index("present")
        self._subjects = [space.rows.index(name) if name in space.rows else -1 for name in actions.about]
        more = (len(space.rows), len(MEMORY_WORDS))
        low, high = (self._join(bound, np.full(more, value)) for bound, value in ((space.low, 0), (space.high, 1)))
        self.observation_space = ObjectsBox(low, high, space.rows, (*space.words, *MEMORY_WORDS))
        self._forget()

    def _forget(self) -> None:
        rows = self._shape[0]
        self._failures: dict[bytes, NDArray[np.bool_]] = {}  # failures by the set of lit objects
        self._since, self._ranks = np.full(rows, np.inf), np.zeros(rows)
        self._shown = np.zeros(rows, dtype=np.bool_)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with an empty memory."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._forget()
        self._shown = self._read_lit(observation)
        return self._remember(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run a decision, and remember its outcome."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        before, after = self._shown, self._read_lit(observation)
        self._since += 1
        subject = self._subjects[int(action)]
        if subject >= 0:
            self._since[subject] = 0
            if not after[subject] and not info.get("trial_ended", False):
                self._failures.setdefault(before.tobytes(), np.zeros_like(before))[subject] = True
        self._ranks[after & ~before] = 1.0 / (1 + before.sum())
        self._shown = after
        return self._remember(observation), reward, terminated, truncated, info

    def _read_lit(self, observation: NDArray[Any]) -> NDArray[np.bool_]:
        """Read from an observation which objects are lit, bool (rows,)."""
        rows, words = self._shape
        return observation[: rows * words].reshape(rows, words)[:, self._lit] > 0.5

    def _remember(self, observation: NDArray[Any]) -> NDArray[Any]:
        failures = self._failures.get(self._shown.tobytes(), np.zeros_like(self._shown))
        return self._join(observation, np.stack([failures, 1.0 / (1 + self._since), self._ranks], axis=1))

    def _join(self, observation: NDArray[Any], memory: NDArray[Any]) -> NDArray[Any]:
        """Observation with the memory (rows, words) at the ends of its rows."""
        rows, words = self._shape
        seen = observation[: rows * words].reshape(rows, words)
        joined = np.concatenate([seen, memory.astype(seen.dtype) * (seen[:, self._present, None] > 0)], axis=1)
        return np.concatenate([joined.ravel(), observation[rows * words :]])
