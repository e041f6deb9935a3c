"""Memory of an episode's decisions, as further numbers in the rows of the observation `objects`.

The dependencies between buttons are hidden, so an agent that sees only the present cannot know what it has tried. A
summary of all decisions so far, beside each object's row, is enough for puzzles without chance. `DecisionMemory` adds
it in one environment, `MemoryStreams` in many.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.options.batched.env import BatchedOptionsEnv, Transitions

MEMORY_WORDS = ("failed", "recent", "rank")
"""Numbers that a memory appends to a row."""


class _Memories:
    """Outcomes that several episodes have met, and the rule by which they are noted.

    Args:
        space: of observations without memory.
        actions: what they are about.
        count: number of episodes side by side.

    Attributes:
        space: of observations with memory.

    Raises:
        UnsupportedError: observations or actions of another kind.
    """

    def __init__(self, space: gymnasium.Space, actions: gymnasium.Space, count: int) -> None:
        if not isinstance(space, ObjectsBox) or not isinstance(actions, PointingDiscrete):
            raise UnsupportedError("a memory of decisions needs rows of objects and actions about them: give it an "
                                   "OptionsEnv over observation='objects'")
        self._shape = len(space.rows), len(space.words)
        self._lit, self._present = space.words.index("lit"), space.words.index("present")
        self._subjects = np.array([space.rows.index(name) if name in space.rows else -1 for name in actions.about])
        more = (1, len(space.rows), len(MEMORY_WORDS))
        low, high = (self._join(bound[None], np.full(more, value))[0]
                     for bound, value in ((space.low, 0), (space.high, 1)))
        self.space = ObjectsBox(low, high, space.rows, (*space.words, *MEMORY_WORDS))
        rows = count, len(space.rows)
        self._failures: list[dict[bytes, NDArray[np.bool_]]] = [{} for _ in range(count)]  # by the set of lit objects
        self._failed, self._lit_now = np.zeros(rows, np.bool_), np.zeros(rows, np.bool_)
        self._since, self._ranks = np.full(rows, np.inf), np.zeros(rows)

    def begin(self, which: NDArray[np.int64], observation: NDArray[Any]) -> None:
        """Empty the memory of some episodes, which begin with these observations, (n, numbers)."""
        for episode in which:
            self._failures[episode] = {}
        self._failed[which], self._ranks[which], self._since[which] = False, 0.0, np.inf
        self._lit_now[which] = self._read_lit(observation)

    def note(self, which: NDArray[np.int64], action: NDArray[np.int64], reached: NDArray[Any], can_fail: bool = True
             ) -> None:
        """Note decisions of some episodes, (n,), and what they reached, (n, numbers)."""
        before, after, subject = self._lit_now[which], self._read_lit(reached), self._subjects[action]
        self._since[which] += 1
        about = (subject >= 0).nonzero()[0]
        self._since[which[about], subject[about]] = 0
        for row in about[~after[about, subject[about]]] if can_fail else ():
            failures = self._failures[which[row]].setdefault(before[row].tobytes(), np.zeros_like(before[row]))
            failures[subject[row]] = True
        ranks = 1.0 / (1 + before.sum(axis=1, keepdims=True))
        self._ranks[which] = np.where(after & ~before, ranks, self._ranks[which])
        self._lit_now[which] = after
        for row, episode in enumerate(which):
            self._failed[episode] = self._failures[episode].get(after[row].tobytes(), False)

    def remember(self, which: NDArray[np.int64] | slice, observation: NDArray[Any]) -> NDArray[Any]:
        """Observations of some episodes, (n, numbers), with their memory."""
        return self._join(observation, np.stack([self._failed[which], 1.0 / (1 + self._since[which]),
                                                 self._ranks[which]], axis=2))

    def _read_lit(self, observation: NDArray[Any]) -> NDArray[np.bool_]:
        """Read from observations which objects are lit, bool (n, rows)."""
        rows, words = self._shape
        return observation[:, : rows * words].reshape(-1, rows, words)[:, :, self._lit] > 0.5

    def _join(self, observation: NDArray[Any], memory: NDArray[Any]) -> NDArray[Any]:
        """Observations with the memory (n, rows, words) at the ends of their rows."""
        rows, words = self._shape
        seen = observation[:, : rows * words].reshape(-1, rows, words)
        joined = np.concatenate([seen, memory.astype(seen.dtype) * (seen[:, :, self._present, None] > 0)], axis=2)
        return np.concatenate([joined.reshape(len(seen), -1), observation[:, rows * words :]], axis=1)

    def state_dict(self) -> dict[str, Any]:
        """All memories, as arrays."""
        failures = [[[np.frombuffer(lit, np.bool_), failed] for lit, failed in each.items()] for each in self._failures]
        return {"failures": failures, "failed": self._failed, "lit_now": self._lit_now, "since": self._since,
                "ranks": self._ranks}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        self._failures = [{np.asarray(lit, np.bool_).tobytes(): np.array(failed, np.bool_) for lit, failed in each}
                          for each in state["failures"]]
        self._failed, self._lit_now = (np.array(state[name], np.bool_) for name in ("failed", "lit_now"))
        self._since, self._ranks = (np.array(state[name], np.float64) for name in ("since", "ranks"))


_ONE = np.zeros(1, np.int64)


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
        self._memory = _Memories(env.observation_space, env.action_space, 1)
        self.observation_space = self._memory.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with an empty memory."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory.begin(_ONE, observation[None])
        return self._memory.remember(_ONE, observation[None])[0], info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run a decision, and remember its outcome."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._memory.note(_ONE, np.array([int(action)]), observation[None], not info.get("trial_ended", False))
        return self._memory.remember(_ONE, observation[None])[0], reward, terminated, truncated, info


class MemoryStreams:
    """The same in many rooms at once, each at its own pace.

    Args:
        streams: a `BatchedOptionsEnv` over `observation="objects"`.

    Attributes:
        observation_space: of one room, with memory.
        observation: of all rooms, (rooms, numbers); to be read where `is_waiting`.

    Raises:
        UnsupportedError: another environment.
    """

    def __init__(self, streams: BatchedOptionsEnv) -> None:
        self._streams = streams
        self.count, self.device, self.gamma = streams.count, streams.device, streams.gamma
        self.action_space = streams.action_space
        self._memory = _Memories(streams.observation_space, streams.action_space, self.count)
        self.observation_space = self._memory.space
        self.observation: Tensor

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (rooms, actions)."""
        return self._streams.action_mask

    @property
    def is_waiting(self) -> Tensor:
        """Rooms that take an action at the next step, bool (rooms,)."""
        return self._streams.is_waiting

    def reset(self, seeds: int) -> None:
        """Begin all episodes anew, with empty memories; room i draws from seed + i."""
        seen = self._streams.reset(seeds)
        self._memory.begin(np.arange(self.count), seen.cpu().numpy())
        self.observation = self._remember(slice(None), seen)

    def step(self, action: Tensor) -> Transitions:
        """Give waiting rooms their actions, int64 (rooms,), and remember the decisions that ended."""
        ended = self._streams.step(action)
        where = ended.where.nonzero().squeeze(1)
        which = where.cpu().numpy()
        before = self._remember(slice(None), ended.observation)
        self._memory.note(which, ended.action[where].cpu().numpy(), ended.next_observation[where].cpu().numpy())
        after = self._remember(slice(None), ended.next_observation)
        over = (ended.where & (ended.terminated | ended.truncated)).nonzero().squeeze(1)
        self._memory.begin(over.cpu().numpy(), self._streams.observation[over].cpu().numpy())
        self.observation = self._remember(slice(None), self._streams.observation)
        return ended._replace(observation=before, next_observation=after)

    def _remember(self, which: NDArray[np.int64] | slice, seen: Tensor) -> Tensor:
        import torch  # which `DecisionMemory` does without

        return torch.from_numpy(self._memory.remember(which, seen.cpu().numpy())).to(self.device)

    def make_single_env(self) -> gymnasium.Env:
        """Make an ordinary environment of the same rooms and options, with a memory."""
        return DecisionMemory(self._streams.make_single_env())

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values."""
        return self._streams.describe()

    def state_dict(self) -> dict[str, Any]:
        """Return rooms, decisions in progress and memories, as arrays."""
        return {"streams": self._streams.state_dict(), "memory": self._memory.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken, in as many of the same rooms."""
        self._streams.load_state_dict(state["streams"])
        self._memory.load_state_dict(state["memory"])
        self.observation = self._remember(slice(None), self._streams.observation)
