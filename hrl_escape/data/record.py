"""Recording of data sets: six kinds of behaviour in the training rooms of a rung; stopped recordings resume.

Seeds of episodes and policies follow from the data set's name, the room and the number of the episode in it, so a
command gives the same episodes on any machine and after any interruption. `medium` is an exception: its network depends
on processor and torch version, so its episodes are reproducible on one machine only. A recording with the name and size
of a published one is compared with it.
"""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.components.exploration import sample_legal
from hrl_escape.agents.state import Kept, Stateful
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.agents.training.train import train
from hrl_escape.data.catalogue import BENCHMARK, DataSpec
from hrl_escape.data.materialise import load_data
from hrl_escape.data.published import compare_published, refuse_other
from hrl_escape.data.recording import DYNAMICS, FIELDS, RECORDING_FORMAT, Recording, load_recording, save_recording
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import EpisodeFileError, PlanningFailed
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.planning.planner import get_planner
from hrl_escape.progress import describe_results, show_progress
from hrl_escape.sets.grammar import find_set, quote_room
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.rung import derive_seed
from hrl_escape.step_info import ENDINGS, read_option
from hrl_escape.version import __version__
from hrl_escape.viewer.play.episode import load_episode

FAILURE = 0.2
"""Probability that an option of `noisy` fails at its start."""
RANDOM_SHARE = 0.1
"""Share of random choices in `medium`."""
MEDIUM_PRIMITIVES, MEDIUM_ROOMS, MEDIUM_EPISODES = 40_000, 20, 20
"""Training budget of `medium` in primitives, number of its rooms, and number of episodes of its efficiency."""
REFERENCE_ROOMS = 20
SAVE_SECONDS = 20.0

ActionRule: TypeAlias = Callable[[Any, NDArray[np.bool_], np.random.Generator, bool], int]
"""(observation, legal actions, generator, whether the episode begins) -> action."""


class RecordingWriter:
    """Recorder of episodes, which can continue another recording."""

    def __init__(self, done: Recording | None = None) -> None:
        self._lists: dict[str, list[Any]] = {
            field.name: [] if done is None else getattr(done, field.name).tolist()
            for field in dataclasses.fields(Recording) if field.name != "about"}

    def __len__(self) -> int:
        return len(self._lists["action"])

    def count_in(self, room: int) -> tuple[int, int]:
        """Return the number of episodes and primitives in a room, the last one recorded or a new one."""
        episodes = 0
        while episodes < len(self._lists["room"]) and self._lists["room"][-1 - episodes] == room:
            episodes += 1
        decisions = sum(self._lists["decisions"][len(self._lists["room"]) - episodes :])
        return episodes, sum(self._lists["duration"][len(self._lists["duration"]) - decisions :])

    @property
    def last_room(self) -> int:
        """Number of the last episode's room; 0 before the first episode."""
        return self._lists["room"][-1] if self._lists["room"] else 0

    def add_decision(self, action: int, legal: NDArray[Any], primitives: list[int], ended: str, cut: bool = False
                     ) -> None:
        """Append a finished decision."""
        row = {"option": action, "duration": len(primitives), "policy": 0, "ended": ENDINGS.index(ended),
               "cut": int(cut), "legal": pack_mask(legal)}
        for name, value in row.items():
            self._lists[name].append(value)
        self._lists["action"].extend(primitives)

    def end_episode(self, seed: int, room: int, decisions: int, legal: NDArray[Any], end: int) -> None:
        """Append the episode of the latest decisions; see `Recording`."""
        row = {"episode_seed": seed, "room": room, "decisions": decisions, "end": end, "legal": pack_mask(legal)}
        for name, value in row.items():
            self._lists[name].append(value)

    def describe_latest(self) -> str:
        """Describe the success of the latest ten episodes for a progress line."""
        return describe_results((), [float(end == 1) for end in self._lists["end"][-10:]])

    def make_recording(self, about: Mapping[str, Any]) -> Recording:
        """Return the recording of all episodes so far."""
        return Recording(about, **{name: np.array(self._lists[name], dtype) for name, dtype in FIELDS.items()})


def pack_mask(legal: NDArray[Any]) -> int:
    """Pack legal actions as bits."""
    return sum(1 << int(action) for action in np.flatnonzero(legal))


def make_about(name: str, kind: str, rooms_text: str, rooms: InstanceSet, env: gymnasium.Env, command: str
               ) -> dict[str, Any]:
    """Make the `about` table of a recording, without scores."""
    inner: Any = env.unwrapped
    names = inner.instance.robot.actions.names
    actions, count = (env.action_names, env.primitive_count) if isinstance(env, OptionsEnv) else (names, len(names))
    return {"format": RECORDING_FORMAT, "name": name, "kind": kind, "rooms": rooms_text,
            "rooms_id": rooms.describe()["id"],
            "engine": "bullet", "dynamics": DYNAMICS, "package": __version__, "command": command,
            "actions": list(actions), "primitive_count": count,
            "policies": [kind], "scores": {}}


def record(spec: DataSpec, path: Path, *, primitives: int | None = None, progress: bool | None = None) -> Recording:
    """Record a data set of the catalogue, and write its recording.

    Args:
        spec: the data set.
        path: file to write; an unfinished recording has the same name with `.part`.
        primitives: number of primitives of a trial; by default the number of the name.
        progress: as in `train`.

    Raises:
        VerificationError: it differs from the published recording; it is then written with the ending `.other.npz`.
    """
    total, part = primitives or spec.primitives, path.with_suffix(".part")
    rooms = find_set(text := spec.list_rooms(total))
    share = -(-total // len(rooms))
    env, choose = _make_behaviour(spec, rooms, path.with_suffix(".medium"))
    command = f"hrl-escape data make {spec.name}" + (f" --primitives {primitives}" if primitives else "")
    about = {**make_about(spec.name, spec.kind, text, rooms, env, command),
             "asked_primitives": total}
    begun = load_recording(part) if part.is_file() else None
    writer = RecordingWriter(begun if begun is not None and begun.about == about else None)
    saved = time.monotonic()
    with show_progress(spec.name, share * len(rooms), len(writer), progress) as report:
        for room in range(writer.last_room, len(rooms)):
            episode, done = writer.count_in(room)
            while done < share:
                seed = derive_seed("data", spec.name, str(room), episode)
                done += _record_episode(writer, env, choose, spec.kind, seed, room, share - done)
                episode += 1
                report(len(writer), f"room {room + 1} of {len(rooms)} {writer.describe_latest()}")
                if time.monotonic() - saved > SAVE_SECONDS:
                    save_recording(part, writer.make_recording(about))
                    saved = time.monotonic()
    env.close()
    recording = writer.make_recording(about)
    scores = _measure(recording) | measure_references(spec.rung, min(len(rooms), REFERENCE_ROOMS))
    recording = dataclasses.replace(recording, about={**about, "scores": scores})
    found = compare_published(spec.name, recording)
    is_other = not (primitives or found.fits)
    path = path.with_suffix(".other.npz") if is_other else path
    save_recording(path, recording)
    part.unlink(missing_ok=True)
    if is_other:
        raise refuse_other(spec.name, found, path)
    return recording


def _record_episode(writer: RecordingWriter, env: gymnasium.Env, choose: ActionRule, kind: str, seed: int, room: int,
                    most: int) -> int:
    """Record one episode of at most `most` primitives; returns its number of primitives."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed, options={"instance_index": room})
    count = decisions = end = 0
    left = int(rng.integers(1, 3))  # decisions of this piece, in `stitch`
    legal = _read_mask(info, env)
    while not end and count < most:
        action = choose(observation, legal, rng, decisions == 0)
        observation, _, terminated, truncated, info = env.step(action)
        end = 1 if terminated else 2 if truncated else 0
        primitives = [int(step.action) for step in env.last_steps] if isinstance(env, OptionsEnv) else [action]
        count, decisions, left = count + len(primitives), decisions + 1, left - 1
        cuts = kind == "stitch" and left == 0
        option = read_option(info)
        ended = "reached" if option is None else option["ended"]
        writer.add_decision(action, legal, primitives, ended, cut=cuts)
        legal = _read_mask(info, env)
        left = int(rng.integers(1, 3)) if cuts else left
    writer.end_episode(seed, room, decisions, legal, end)
    return count


def _read_mask(info: Mapping[str, Any], env: gymnasium.Env) -> NDArray[np.bool_]:
    mask = info.get("action_mask")
    return np.ones(env.action_space.n, np.bool_) if mask is None else mask != 0  # type: ignore[attr-defined]


# --- behaviours ------------------------------------------------------------------------------


def _make_behaviour(spec: DataSpec, rooms: InstanceSet, folder: Path) -> tuple[gymnasium.Env, ActionRule]:
    """Make the environment of a kind and its policy."""
    room = rooms.make_env(observation="objects" if spec.kind == "medium" else "features")
    if spec.kind == "explore":
        return room, _choose_any
    degradation = OptionDegradation(failure=FAILURE) if spec.kind == "noisy" else None
    env = OptionsEnv(room, degradation, include_primitives=False)
    if spec.kind == "expert":
        return env, _Expert(env)
    if spec.kind != "medium":
        return env, _choose_any
    policy = train_medium(rooms[:MEDIUM_ROOMS], folder).make_policy()

    def choose(observation: Any, legal: NDArray[np.bool_], rng: np.random.Generator, begins: bool) -> int:
        """Return the agent's greedy choice, or a random one with probability 0.1."""
        if begins:
            policy.begin_episode(rng)
        return sample_legal(legal, rng) if rng.random() < RANDOM_SHARE else policy.choose(observation, legal)

    return env, choose


def _choose_any(observation: Any, legal: NDArray[np.bool_], rng: np.random.Generator, begins: bool) -> int:
    return sample_legal(legal, rng)


class _Expert:
    """Follow the oracle's options, planned for each episode; a random legal option if planning fails."""

    def __init__(self, env: OptionsEnv) -> None:
        self._env = env
        self._order: Iterator[Any] = iter(())

    def __call__(self, observation: Any, legal: NDArray[np.bool_], rng: np.random.Generator, begins: bool) -> int:
        room: Any = self._env.unwrapped
        if begins:
            with suppress(PlanningFailed):
                self._order = iter(get_planner(room.instance).order_goals(room.get_state()))
        goals = [getattr(option, "goal", None) for option in self._env.options]
        for goal in self._order:
            if goal in goals and legal[goals.index(goal)]:
                return goals.index(goal)
        return sample_legal(legal, rng)


class HalfWay(Stateful):
    """Probe that ends a run when the efficiency over the latest episodes is half of the best known one."""

    STATE = (Kept("_latest", pack=list, unpack=lambda saved: deque(saved, maxlen=MEDIUM_EPISODES)),)

    def __init__(self, fewest: float) -> None:
        self._fewest = fewest
        self._latest: deque[float] = deque(maxlen=MEDIUM_EPISODES)
        self.is_done = False

    @property
    def identity(self) -> dict[str, Any]:
        """Rule that ends the run, part of its key."""
        return {"until": "half efficiency", "fewest": self._fewest}

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Nothing to measure."""

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Record the episode's length."""
        self._latest.append(self._fewest / episode.length if episode.success else 0.0)
        self.is_done = len(self._latest) == MEDIUM_EPISODES and float(np.mean(self._latest)) >= 0.5


def train_medium(rooms: InstanceSet, folder: Path) -> Agent:
    """Train `smdp-dqn` in some rooms until it has half of the oracle's efficiency, or the budget is spent.

    It explores with the same probability as in the recording, so training episodes measure the recorded efficiency.
    """
    fewest = float(np.mean([_count_fewest(room) for room in rooms]))
    env = rooms.make_env({"include_primitives": False}, observation="objects")
    try:
        result = train("smdp-dqn", env, primitives=MEDIUM_PRIMITIVES, seed=0, eval_episodes=0, probe=HalfWay(fewest),
                       settings={"network": "objects", "epsilon_start": RANDOM_SHARE, "epsilon_end": RANDOM_SHARE},
                       out=folder, observed=False)
        assert result.agent is not None
        return result.agent
    finally:
        env.close()


# --- scores ----------------------------------------------------------------------------------


def _count_fewest(room: Any) -> float:
    """Return the primitives of the best known escape from the room's first start, or the horizon."""
    return float(find_best_known(room, list_start_states(room)[0]).primitives or room.horizon)


@cache
def measure_references(rung: str, count: int = REFERENCE_ROOMS) -> dict[str, float]:
    """Compute mean returns in the first test rooms: of random options (`chance`), and best known (`best_known`)."""
    rooms = find_set(f"{BENCHMARK}/{rung}/test#0..{count}")
    best = [find_best_known(room, list_start_states(room)[0]).value for room in rooms]
    env = rooms.make_env({"include_primitives": False}, observation="features")
    returns = []
    for index in range(len(rooms)):
        rng = np.random.default_rng(index)
        _, info = env.reset(seed=index, options={"instance_index": index})
        total, over = 0.0, False
        while not over:
            _, reward, terminated, truncated, info = env.step(sample_legal(info["action_mask"] != 0, rng))
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
    env.close()
    return {"chance": float(np.mean(returns)), "best_known": float(np.mean(best)), "reference_rooms": count}


def _measure(recording: Recording) -> dict[str, float]:
    """Compute mean return, mean length and success rate of the recording's complete episodes."""
    returns: list[float] = []
    for block in load_data(recording, observation="features").blocks("decisions"):
        returns.extend(np.bincount(block.trajectory - block.trajectory[0], block.summed_reward))
    whole = recording.end[recording.end != 0]
    return {"trajectories": len(returns), "mean_return": float(np.mean(returns)),
            "mean_length": len(recording.action) / len(returns), "whole_episodes": len(whole),
            "escapes": float(np.mean(whole == 1)) if len(whole) else 0.0}


def make_played_recording(name: str, rooms: str, paths: Sequence[str | Path]) -> Recording:
    """Make a recording from episodes saved by `hrl-escape play`; its decisions are the moves, including primitives.

    Rooms are given as a text, such as `paper-two-button#0`.

    Raises:
        EpisodeFileError: no episode, a room that is not in `rooms`, or moves whose replay differs.
    """
    if not paths:
        raise EpisodeFileError("no episode is given: save some with the Save button of hrl-escape play")
    found = find_set(rooms)
    numbers = {room.id: index for index, room in enumerate(found)}
    writer, envs = RecordingWriter(), {}
    for path in paths:
        saved = load_episode(path)
        room = numbers.get(saved.instance.id)
        if room is None or not saved.moves:
            raise EpisodeFileError(f"{path}: " + (f"its room is none of {rooms}" if room is None else
                                                  "nobody moved in this episode"))
        if room not in envs:
            envs[room] = OptionsEnv(EscapeRoomEnv(instance=found[room], observation="features"))
        env = envs[room]
        _, info = env.reset(seed=saved.seed)
        legal, end = info["action_mask"], 0
        for move, primitives, ended in saved.moves:
            if end or move not in env.action_names:
                raise EpisodeFileError(f"{path}: the move {move!r} is none of this room, or comes after the end")
            for primitive in primitives:
                _, _, terminated, truncated, info = env.step(primitive)
                end = 1 if terminated else 2 if truncated else 0
            writer.add_decision(env.action_names.index(move), legal, list(primitives), ended or "reached")
            legal = info["action_mask"]
        writer.end_episode(saved.seed, room, len(saved.moves), np.asarray(legal), end)
    env = next(iter(envs.values()))
    command = f"hrl-escape data make {name} --room {quote_room(rooms)} --played FILES"
    about = make_about(name, "played", rooms, found, env, command)
    for each in envs.values():
        each.close()
    return writer.make_recording(about)
