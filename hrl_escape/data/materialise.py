"""Tapes replayed into observations, rewards and masks: `load_data`, block by block.

The replay is the engine's own kinematics, episode by episode from its seed, so that what comes out is what the agent
saw, to the bit. It never holds more than one block beside the tape, unless all of it is asked for.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.offline import Primitives, RecordedDecisions
from hrl_escape.data.catalogue import find_tape
from hrl_escape.data.published import warn_of_other
from hrl_escape.data.tape import ENDS, Tape, load_tape
from hrl_escape.env.engine import make_renderer
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.noise import draw_episode
from hrl_escape.env.observations.base import get_observation, make_observer
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.ladder.instance_set import InstanceSet

DataLevel = Literal["primitives", "decisions"]
BLOCK = 65_536
"""Primitives in a block, at least; an episode is never cut in two."""


class TapeEpisode(NamedTuple):
    """Places of an episode in a tape's arrays: its number, and slices of its decisions and primitives."""

    number: int
    decisions: slice
    primitives: slice


def list_episodes(tape: Tape) -> list[TapeEpisode]:
    """Places of all episodes of a tape, in order."""
    first = np.concatenate([[0], np.cumsum(tape.decisions, dtype=np.int64)])
    at = np.concatenate([[0], np.cumsum(tape.duration, dtype=np.int64)])
    return [TapeEpisode(n, slice(int(i), int(j)), slice(int(at[i]), int(at[j])))
            for n, (i, j) in enumerate(itertools.pairwise(first))]


def begin_episode(rules: Kinematics, tape: Tape, number: int) -> RoomState:
    """First state of an episode of a tape, by its number, under the rules of its room."""
    start, key = draw_episode(int(tape.episode_seed[number]), 0, len(rules.instance.starts))
    return rules.make_state(rules.instance.starts[start], key)


class DataSet:
    """A tape, and what is to be read from it.

        data = load_data("lattice-play-v1")
        decisions = data.read_decisions(gamma=0.99)
        blocks = data.blocks("primitives")  # one after another

    Args:
        tape: the tape.
        observation: by name, as of `EscapeRoomEnv`.
        level: what `read` and `blocks` give by default, `decisions` or `primitives`.
        gamma: discount per primitive, likewise.
        rooms: set of the rung that `make_env` tests in.
    """

    def __init__(self, tape: Tape, observation: str = "objects", level: DataLevel = "decisions", gamma: float = 0.99,
                 rooms: str = "test") -> None:
        if level not in ("decisions", "primitives"):
            raise ConfigError("level", level, "'decisions' or 'primitives'")
        if not 0.0 <= gamma <= 1.0:
            raise ConfigError("gamma", gamma, "a number from 0 to 1")
        self.tape, self.observation, self.level, self.gamma, self._rooms = tape, observation, level, gamma, rooms
        self._vector = get_observation(observation).is_vector

    def __repr__(self) -> str:
        return f"<DataSet of {self.tape!r}: {self.observation}, {self.level}>"

    def __len__(self) -> int:
        return len(self.tape.option if self.level == "decisions" else self.tape.action)

    def _repr_svg_(self) -> str:
        return self.tape.rooms[: min(4, len(self.tape.rooms))]._repr_svg_()

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.tape.about["name"]

    @property
    def identity(self) -> Mapping[str, Any]:
        """Name, content hash and observation."""
        return {"name": self.name, "digest": self.tape.digest, "observation": self.observation}

    @property
    def test_rooms(self) -> InstanceSet:
        """Rooms to be tested in: another set of the rung; those of the tape where it is of no rung."""
        place = self.tape.rooms.place
        if place is None or self._rooms == "own":
            return self.tape.rooms
        from hrl_escape.ladder.benchmark import load_benchmark

        return load_benchmark(place["benchmark"])[place["rung"]].sets[self._rooms]

    def make_env(self, options: bool, gamma: float) -> gymnasium.Env:
        """Make the environment to be tested in, with the actions of the decisions, or of the primitives."""
        has_options = options and len(self.tape.about["actions"]) > self.tape.primitive_count
        given: Any = {"include_primitives": self.tape.primitive_count > 0, "discount": gamma} if has_options else False
        return self.test_rooms.make_env(given, observation=self.observation)

    # --- reading -------------------------------------------------------------------------

    def read(self) -> RecordedDecisions | Primitives:
        """All of the level, in memory."""
        return self.read_decisions(self.gamma) if self.level == "decisions" else self.read_primitives()

    def read_decisions(self, gamma: float) -> RecordedDecisions:
        """All decisions, in memory, with rewards discounted by gamma."""
        return _join(RecordedDecisions, list(self.blocks("decisions", gamma)))

    def read_primitives(self) -> Primitives:
        """All primitives, in memory."""
        return _join(Primitives, list(self.blocks("primitives")))

    def blocks(self, level: DataLevel | None = None, gamma: float | None = None, size: int = BLOCK
               ) -> Iterator[Any]:
        """Yield the data in blocks of whole episodes, in order, each `Decisions` or `Primitives`.

        Each but the last has at least `size` primitives; level and discount are the data set's by default.
        """
        every, gamma = (level or self.level) == "primitives", self.gamma if gamma is None else gamma
        make = self._make_primitives if every else self._make_decisions
        gathered: list[TapeEpisode] = []
        seen: list[NDArray[Any]] = []
        rewards: list[float] = []
        for room, episodes in itertools.groupby(list_episodes(self.tape), lambda each: self.tape.room[each.number]):
            instance = self.tape.rooms[int(room)]
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

    def _replay(self, rules: Kinematics, observe: Callable[[RoomState], NDArray[Any]], episode: TapeEpisode,
                every: bool, seen: list[NDArray[Any]], rewards: list[float]) -> None:
        """Append an episode's rewards, and observations of every state, or where decisions begin; check how it ends."""
        durations = self.tape.duration[episode.decisions].tolist()
        actions = self.tape.action[episode.primitives].tolist()
        state = begin_episode(rules, self.tape, episode.number)
        seen.append(observe(state))
        step, at, end = rules.step, 0, 0
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
        if end != self.tape.end[episode.number] or (end and at != state.primitives):
            raise FileReadError(f"tape {self.name}: episode {episode.number} ends {ENDS[end]} after {state.primitives} "
                                f"primitives and was recorded as {ENDS[self.tape.end[episode.number]]} after {at}; "
                                "other rules recorded it")

    def _make_decisions(self, episodes: list[TapeEpisode], seen: list[NDArray[Any]], rewards: list[float], gamma: float
                        ) -> RecordedDecisions:
        tape, rows, after = self.tape, _cover(episodes), _skip_last(each.decisions for each in episodes)
        duration = tape.duration[rows].astype(np.int64)
        discounted, summed = _discount(np.array(rewards), duration, gamma)
        powers = np.array([gamma**k for k in range(int(duration.max()) + 1)])
        observation = np.array(seen)
        first = rows.start + episodes[0].number
        legal = tape.legal[first : first + len(seen)]
        bits = np.arange(len(tape.about["actions"]), dtype=np.uint64)
        mask = (legal[:, None] >> bits & np.uint64(1)).astype(np.bool_)
        terminated, last, trajectory = self._find_ends(episodes, rows)
        return RecordedDecisions(
            observation[after], tape.option[rows].astype(np.int64), mask[after], discounted, summed, duration,
            powers[duration], observation[after + 1], mask[after + 1], terminated, last, trajectory,
            tape.ended[rows].astype(np.int64))

    def _make_primitives(self, episodes: list[TapeEpisode], seen: list[NDArray[Any]], rewards: list[float], gamma: float
                         ) -> Primitives:
        del gamma
        tape, rows, after = self.tape, _cover(episodes), _skip_last(each.primitives for each in episodes)
        duration = tape.duration[rows].astype(np.int64)
        ends, count = np.cumsum(duration), len(rewards)
        terminated, last, trajectory = self._find_ends(episodes, rows)
        at_end = [np.zeros(count, np.bool_) for _ in range(3)]
        for flags, values in zip(at_end, (terminated, last, np.ones_like(last)), strict=True):
            flags[ends - 1] = values
        observation = np.array(seen)
        begins = np.zeros(count, np.bool_)
        begins[ends - duration] = True
        return Primitives(observation[after], tape.action[episodes[0].primitives.start : episodes[-1].primitives.stop]
                          .astype(np.int64), np.array(rewards), observation[after + 1], at_end[0], at_end[1],
                          np.repeat(trajectory, duration), np.repeat(tape.option[rows].astype(np.int64), duration),
                          begins)

    def _find_ends(self, episodes: list[TapeEpisode], rows: slice
                   ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
        """Flags of the decisions that terminate and that are a trajectory's last, and the number of the trajectory."""
        tape = self.tape
        finals = np.array([episode.decisions.stop - 1 for episode in episodes]) - rows.start
        terminated = np.zeros(rows.stop - rows.start, np.bool_)
        terminated[finals] = tape.end[episodes[0].number : episodes[-1].number + 1] == 1
        last = tape.cut[rows] != 0
        last[finals] = True
        return terminated, last, self._trajectories[rows]

    @cached_property
    def _trajectories(self) -> NDArray[np.int64]:
        last = self.tape.cut != 0
        last[np.cumsum(self.tape.decisions) - 1] = True
        return np.concatenate([[0], np.cumsum(last)[:-1]]).astype(np.int64)


def load_data(name: str | PathLike[str] | Tape, observation: str = "objects", level: DataLevel = "decisions",
              gamma: float = 0.99, rooms: str = "test") -> DataSet:
    """Open a data set.

    Loaded by a published name, a trial run or a differing `medium` gives a warning.

    Args:
        name: of the catalogue, the path of a tape, or a tape.
        observation: by name, as of `EscapeRoomEnv`.
        level: `decisions` or `primitives`.
        gamma: discount per primitive.
        rooms: set of the rung that agents are tested in; `own` for the rooms of the tape.

    Raises:
        UnknownNameError: no such data set or observation.
        FileReadError: it has not been recorded, or the tape is damaged or of another engine.
        VerificationError: by a published name, the tape is another, which another version of an engine made; its path
            opens it all the same.
    """
    if isinstance(name, Tape):
        tape = name
    else:
        path = find_tape(name if isinstance(name, str) else Path(name))
        tape = load_tape(path)
        if isinstance(name, str):
            warn_of_other(name, tape, path)
    return DataSet(tape, observation, level, gamma, rooms)


def _discount(rewards: NDArray[np.float64], duration: NDArray[np.int64], gamma: float
              ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Discounted and plain sums of the rewards of each decision, in the order of sums of `OptionsEnv`."""
    begin = np.cumsum(duration) - duration
    discounted, summed = np.zeros(len(duration)), np.zeros(len(duration))
    for place in range(int(duration.max())):
        rows = duration > place
        summed[rows] += rewards[begin[rows] + place]
        back = duration[rows] - 1 - place
        discounted[rows] = rewards[begin[rows] + back] + gamma * discounted[rows]
    return discounted, summed


def _cover(episodes: list[TapeEpisode]) -> slice:
    """Decisions of neighbouring episodes."""
    return slice(episodes[0].decisions.start, episodes[-1].decisions.stop)


def _skip_last(steps: Iterable[slice]) -> NDArray[np.int64]:
    """Places of all states but each episode's last, where an episode of n steps shows n + 1 states."""
    counts = [each.stop - each.start for each in steps]
    return np.arange(sum(counts)) + np.repeat(np.arange(len(counts)), counts)


def _join(kind: Any, blocks: list[Any]) -> Any:
    return kind(*(np.concatenate(fields) for fields in zip(*blocks, strict=True)))
