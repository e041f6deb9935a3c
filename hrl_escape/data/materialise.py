"""Replay of recordings into observations, rewards and masks, block by block.

Episodes are replayed from their seeds by the engine's kinematics and equal the recorded ones to the last bit. Memory
holds the recording and one block, unless all data are requested.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.offline import Primitives, RecordedDecisions
from hrl_escape.data.catalogue import find_recording
from hrl_escape.data.published import warn_of_other
from hrl_escape.data.recording import ENDS, Recording, load_recording
from hrl_escape.env.engine import make_renderer
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.noise import draw_episode
from hrl_escape.env.observations.base import get_observation, make_observer
from hrl_escape.errors import FileReadError, UnknownNameError
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.settings import Range, read_argument

DataLevel = Literal["primitives", "decisions"]
_GAMMA = Annotated[float, Range(0, 1)]
BLOCK = 65_536
"""Smallest number of primitives in a block; episodes are not divided."""


class RecordingEpisode(NamedTuple):
    """Position of an episode in a recording's arrays: its number and the slices of its decisions and primitives."""

    number: int
    decisions: slice
    primitives: slice


def list_episodes(recording: Recording) -> list[RecordingEpisode]:
    """Return the positions of all episodes of a recording, in order."""
    first = np.concatenate([[0], np.cumsum(recording.decisions, dtype=np.int64)])
    at = np.concatenate([[0], np.cumsum(recording.duration, dtype=np.int64)])
    return [RecordingEpisode(n, slice(int(i), int(j)), slice(int(at[i]), int(at[j])))
            for n, (i, j) in enumerate(itertools.pairwise(first))]


def begin_episode(rules: Kinematics, recording: Recording, number: int) -> RoomState:
    """Return the first state of an episode of a recording, with the rules of its room."""
    start, key = draw_episode(int(recording.episode_seed[number]), 0, len(rules.instance.starts))
    return rules.make_state(rules.instance.starts[start], key)


class DataSet:
    """Data set: a recording with the observation and level to read.

        data = load_data("lattice-play-v1")
        decisions = data.read_decisions(gamma=0.99)
        blocks = data.blocks("primitives")  # one after another

    Args:
        recording: the recording.
        observation: by name, as in `EscapeRoomEnv`.
        level: default of `read` and `blocks`, `decisions` or `primitives`.
        gamma: default discount per primitive.
        rooms: set of the rung for `make_env`.
    """

    def __init__(self, recording: Recording, observation: str = "objects", level: DataLevel = "decisions",
                 gamma: float = 0.99, rooms: str = "test") -> None:
        read_argument(DataLevel, "level", level)
        self.recording, self._rooms = recording, rooms
        self.observation, self.level, self.gamma = observation, level, read_argument(_GAMMA, "gamma", gamma)
        self._vector = get_observation(observation).is_vector
        if rooms != "test":
            _ = self.test_rooms  # raises for an unknown set

    def __repr__(self) -> str:
        return f"<DataSet of {self.recording!r}: {self.observation}, {self.level}>"

    def __len__(self) -> int:
        return len(self.recording.option if self.level == "decisions" else self.recording.action)

    def _repr_svg_(self) -> str:
        return self.recording.rooms[: min(4, len(self.recording.rooms))]._repr_svg_()

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.recording.about["name"]

    @property
    def identity(self) -> Mapping[str, Any]:
        """Name, content hash and observation."""
        return {"name": self.name, "digest": self.recording.digest, "observation": self.observation}

    @property
    def test_rooms(self) -> InstanceSet:
        """Test rooms: another set of the rung, or the recording's rooms if they do not belong to a rung.

        Raises:
            UnknownNameError: the rung has no such set.
        """
        place = self.recording.rooms.place
        if self._rooms == "own" or (place is None and self._rooms == "test"):
            return self.recording.rooms
        from hrl_escape.sets.benchmark import load_benchmark

        sets = {} if place is None else load_benchmark(place["benchmark"])[place["rung"]].sets
        if self._rooms not in sets:
            raise UnknownNameError("set of rooms", self._rooms, (*sets, "own"))
        return sets[self._rooms]

    def make_env(self, options: bool, gamma: float) -> gymnasium.Env:
        """Make the test environment, with the actions of the decisions or of the primitives."""
        primitives = self.recording.primitive_count
        has_options = options and len(self.recording.about["actions"]) > primitives
        given: Any = {"include_primitives": primitives > 0, "discount": gamma} if has_options else False
        return self.test_rooms.make_env(given, observation=self.observation)

    # --- reading -------------------------------------------------------------------------

    def read(self) -> RecordedDecisions | Primitives:
        """Read all data of the default level."""
        return self.read_decisions(self.gamma) if self.level == "decisions" else self.read_primitives()

    def read_decisions(self, gamma: float) -> RecordedDecisions:
        """Read all decisions, with rewards discounted by gamma, from 0 to 1."""
        return _join(RecordedDecisions, list(self.blocks("decisions", gamma)))

    def read_primitives(self) -> Primitives:
        """Read all primitives."""
        return _join(Primitives, list(self.blocks("primitives")))

    def blocks(self, level: DataLevel | None = None, gamma: float | None = None, size: int = BLOCK
               ) -> Iterator[Any]:
        """Yield the data in blocks of whole episodes, in order, each `Decisions` or `Primitives`.

        Each block except the last has at least `size` primitives. Level and discount default to the data set's.

        Raises:
            ConfigError: no such level, a discount outside 0 to 1, or a size below 1.
        """
        discount: float = self.gamma if gamma is None else read_argument(_GAMMA, "gamma", gamma)
        every = (self.level if level is None else read_argument(DataLevel, "level", level)) == "primitives"
        return self._yield_blocks(every, discount, read_argument(Annotated[int, Range(1)], "size", size))

    def _yield_blocks(self, every: bool, gamma: float, size: int) -> Iterator[Any]:
        make = self._make_primitives if every else self._make_decisions
        gathered: list[RecordingEpisode] = []
        seen: list[NDArray[Any]] = []
        rewards: list[float] = []
        recording = self.recording
        for room, episodes in itertools.groupby(list_episodes(recording), lambda each: recording.room[each.number]):
            instance = recording.rooms[int(room)]
            rules = Kinematics(instance)
            observer = make_observer(self.observation, rules, None if self._vector else make_renderer(instance))
            for episode in episodes:
                self._replay(rules, observer.observe, episode, every, seen, rewards)
                gathered.append(episode)
                if len(rewards) >= size:
                    yield make(gathered, seen, rewards, gamma)
                    gathered, seen, rewards = [], [], []
        if gathered:
            yield make(gathered, seen, rewards, gamma)

    def _replay(self, rules: Kinematics, observe: Callable[[RoomState], NDArray[Any]], episode: RecordingEpisode,
                every: bool, seen: list[NDArray[Any]], rewards: list[float]) -> None:
        """Append rewards and observations of an episode, of all states or of decisions, and check its end."""
        durations = self.recording.duration[episode.decisions].tolist()
        actions = self.recording.action[episode.primitives].tolist()
        state = begin_episode(rules, self.recording, episode.number)
        seen.append(observe(state))
        step, at, end = rules.step, 0, 0
        if max(actions) >= len(rules.actions):
            raise FileReadError(f"recording {self.name}: episode {episode.number} has the primitive {max(actions)}, "
                                f"and its room {len(rules.actions)} primitives, counted from 0")
        for duration in durations:
            for action in actions[at : at + duration]:
                if end:
                    break
                state, reward, terminated, truncated, _ = step(state, action)
                rewards.append(reward)
                if every:
                    seen.append(observe(state))
                end = 1 if terminated else 2 if truncated else 0
            at += duration
            if not every:
                seen.append(observe(state))
        if end != self.recording.end[episode.number] or (end and at != state.primitives):
            recorded = ENDS[self.recording.end[episode.number]]
            raise FileReadError(f"recording {self.name}: episode {episode.number} ends {ENDS[end]} after "
                                f"{state.primitives} primitives and was recorded as {recorded} after {at}; other rules "
                                "recorded it")

    def _make_decisions(self, episodes: list[RecordingEpisode], seen: list[NDArray[Any]], rewards: list[float],
                        gamma: float) -> RecordedDecisions:
        recording, rows, after = self.recording, _cover(episodes), _skip_last(each.decisions for each in episodes)
        duration = recording.duration[rows].astype(np.int64)
        discounted, summed = discount_rewards(np.array(rewards), duration, gamma)
        powers = np.array([gamma**k for k in range(int(duration.max()) + 1)])
        observation = np.array(seen)
        first = rows.start + episodes[0].number
        legal = recording.legal[first : first + len(seen)]
        bits = np.arange(len(recording.about["actions"]), dtype=np.uint64)
        mask = (legal[:, None] >> bits & np.uint64(1)).astype(np.bool_)
        terminated, last, trajectory = self._find_ends(episodes, rows)
        return RecordedDecisions(
            observation[after], recording.option[rows].astype(np.int64), mask[after], discounted, summed, duration,
            powers[duration], observation[after + 1], mask[after + 1], terminated, last, trajectory,
            recording.ended[rows].astype(np.int64))

    def _make_primitives(self, episodes: list[RecordingEpisode], seen: list[NDArray[Any]], rewards: list[float],
                         gamma: float) -> Primitives:
        del gamma
        recording, rows, after = self.recording, _cover(episodes), _skip_last(each.primitives for each in episodes)
        duration = recording.duration[rows].astype(np.int64)
        ends, count = np.cumsum(duration), len(rewards)
        terminated, last, trajectory = self._find_ends(episodes, rows)
        at_end = [np.zeros(count, np.bool_) for _ in range(3)]
        for flags, values in zip(at_end, (terminated, last, np.ones_like(last)), strict=True):
            flags[ends - 1] = values
        observation = np.array(seen)
        begins = np.zeros(count, np.bool_)
        begins[ends - duration] = True
        action = recording.action[episodes[0].primitives.start : episodes[-1].primitives.stop].astype(np.int64)
        return Primitives(observation[after], action, np.array(rewards), observation[after + 1], at_end[0], at_end[1],
                          np.repeat(trajectory, duration), np.repeat(recording.option[rows].astype(np.int64), duration),
                          begins)

    def _find_ends(self, episodes: list[RecordingEpisode], rows: slice
                   ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
        """Return flags of terminating decisions and of last decisions, and the number of each trajectory."""
        recording = self.recording
        finals = np.array([episode.decisions.stop - 1 for episode in episodes]) - rows.start
        terminated = np.zeros(rows.stop - rows.start, np.bool_)
        terminated[finals] = recording.end[episodes[0].number : episodes[-1].number + 1] == 1
        last = recording.cut[rows] != 0
        last[finals] = True
        return terminated, last, self._trajectories[rows]

    @cached_property
    def _trajectories(self) -> NDArray[np.int64]:
        last = self.recording.cut != 0
        last[np.cumsum(self.recording.decisions) - 1] = True
        return np.concatenate([[0], np.cumsum(last)[:-1]]).astype(np.int64)


def load_data(name: str | PathLike[str] | Recording, observation: str = "objects", level: DataLevel = "decisions",
              gamma: float = 0.99, rooms: str = "test") -> DataSet:
    """Open a data set.

    A trial or a different `medium` recording under a published name gives a warning.

    Args:
        name: of the catalogue, the path of a recording, or a recording.
        observation: by name, as of `EscapeRoomEnv`.
        level: `decisions` or `primitives`.
        gamma: discount per primitive.
        rooms: set of the rung for tests; `own` for the rooms of the recording.

    Raises:
        UnknownNameError: no such data set or observation.
        FileReadError: it has not been recorded, or the recording is damaged or of another engine.
        VerificationError: the recording differs from the published one of its name, because another engine version made
            it; it can be opened by its path.
    """
    if isinstance(name, Recording):
        recording = name
    else:
        path = find_recording(name if isinstance(name, str) else Path(name))
        recording = load_recording(path)
        if isinstance(name, str):
            warn_of_other(name, recording, path)
    return DataSet(recording, observation, level, gamma, rooms)


def discount_rewards(rewards: NDArray[np.float64], duration: NDArray[np.int64], gamma: float
                     ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute discounted and plain sums of each decision's rewards, in the order of summation of `OptionsEnv`.

    Args:
        rewards: of all primitives, float64 (P,).
        duration: primitives of each decision, int64 (D,).
        gamma: discount per primitive.

    Returns:
        Discounted and plain sums, float64 (D,) each.
    """
    begin = np.cumsum(duration) - duration
    discounted, summed = np.zeros(len(duration)), np.zeros(len(duration))
    for place in range(int(duration.max())):
        rows = duration > place
        summed[rows] += rewards[begin[rows] + place]
        back = duration[rows] - 1 - place
        discounted[rows] = rewards[begin[rows] + back] + gamma * discounted[rows]
    return discounted, summed


def _cover(episodes: list[RecordingEpisode]) -> slice:
    """Decisions of neighbouring episodes."""
    return slice(episodes[0].decisions.start, episodes[-1].decisions.stop)


def _skip_last(steps: Iterable[slice]) -> NDArray[np.int64]:
    """Return the indices of all states except each episode's last; an episode of n steps has n + 1 states."""
    counts = [each.stop - each.start for each in steps]
    return np.arange(sum(counts)) + np.repeat(np.arange(len(counts)), counts)


def _join(kind: Any, blocks: list[Any]) -> Any:
    return kind(*(np.concatenate(fields) for fields in zip(*blocks, strict=True)))
