"""Learners from many rooms at once, which spend a million primitives in a minute, tested in unseen rooms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from studies.baseline import BaselineRun
from studies.generalisation.grids import AT_ONCE, TRAINED, TRANSFER, make_depth_sets
from studies.unseen import (
    Streams,
    UnseenRooms,
    get_unseen,
    make_streams,
    make_unseen,
    play_agent,
    play_unseen,
    stream_rooms,
    train_agent,
)

__all__ = ["STREAMS", "get_course", "measure_courses", "measure_many", "name_rooms", "run_course", "run_many",
           "run_reference"]

STREAMS = 256
"""Rooms that a learner learns from at once; with fewer training rooms, several are the same."""


def measure_many(benchmark: str, rung: str, jobs: Sequence[tuple[str, int, int]], primitives: int, tested: int,
                 workers: int) -> Iterator[BaselineRun]:
    """Make runs, and give each as soon as it is done.

    Args:
        benchmark: name.
        rung: name.
        jobs: agent, number of training rooms, and seed, of each run.
        primitives: of a run, in all rooms together.
        tested: number of unseen rooms, an episode in each.
        workers: processes.
    """
    with ProcessPoolExecutor(workers, get_fork_server()) as pool:
        for done in as_completed([pool.submit(run_many, benchmark, rung, *job, primitives, tested) for job in jobs]):
            yield done.result()


def measure_courses(benchmark: str, jobs: Sequence[tuple[str, str, int]], primitives: int, trained: int, tested: int,
                    workers: int) -> Iterator[list[BaselineRun]]:
    """Make runs in some rooms, and give the tests of each in others as soon as they are done.

    Args:
        benchmark: name.
        jobs: course, agent and seed of each run; see `get_course`.
        primitives: of a run, in all rooms together.
        trained: number of training rooms.
        tested: number of unseen rooms of each kind, an episode in each.
        workers: processes.
    """
    with ProcessPoolExecutor(workers, get_fork_server()) as pool:
        for done in as_completed([pool.submit(run_course, benchmark, *job, primitives, trained, tested)
                                  for job in jobs]):
            yield done.result()


def run_many(benchmark: str, rung: str, agent: str, size: int, seed: int, primitives: int, tested: int) -> BaselineRun:
    """One run; see `measure_many`."""
    made, first_escape = train_agent(
        AgentSpec.parse(agent), make_streams(benchmark, rung, size, STREAMS, agent), primitives, seed)
    settings = {"benchmark": benchmark, "rung": rung, "rooms": size, "seed": seed, "primitives": primitives}
    rooms = f"{name_rooms(benchmark, rung, 'train', size)} > {name_rooms(benchmark, rung, 'test', tested)}"
    efficiency, escapes = _play(get_unseen(benchmark, rung, tested), agent, made)
    seen, _ = _play(_get_seen(benchmark, rung, min(size, tested)), agent, made)
    return BaselineRun("sizes", rung, rooms, agent + AT_ONCE, seed, primitives, efficiency, seen, escapes, tested,
                       escapes, first_escape, _compute_key(agent, settings))


def run_course(benchmark: str, course: str, agent: str, seed: int, primitives: int, trained: int, tested: int
               ) -> list[BaselineRun]:
    """One run and its tests; see `measure_courses`."""
    _, tests, known = get_course(benchmark, course, trained, tested)
    made, first_escape = train_agent(
        AgentSpec.parse(agent), _stream_course(benchmark, course, trained, tested, agent), primitives, seed)
    seen, _ = _play(known, agent, made)
    settings = {"benchmark": benchmark, "rooms": trained, "seed": seed, "primitives": primitives, "course": course}

    def test(rung: str) -> BaselineRun:
        rooms = (f"{course} > {rung}" if course == TRAINED else
                 f"{name_rooms(benchmark, course, 'train', trained)} > {name_rooms(benchmark, rung, 'test', tested)}")
        efficiency, escapes = _play(tests[rung], agent, made)
        return BaselineRun("depth" if course == TRAINED else "transfer", rung, rooms, agent + AT_ONCE, seed, primitives,
                           efficiency, seen, escapes, tested, escapes, first_escape,
                           _compute_key(agent, settings | {"rung": rung}))

    return [test(rung) for rung in tests]


def name_rooms(benchmark: str, rung: str, half: Literal["train", "test"], count: int) -> str:
    """The first rooms of a rung's half, in a line."""
    return f"{benchmark}/{rung}/{half}#0..{count}"


def run_reference(benchmark: str, rung: str, agent: str, tested: int) -> BaselineRun:
    """Tests of an agent that learns nothing, in the rooms that all courses over rungs share."""
    unseen = get_unseen(benchmark, rung, tested)
    efficiency, escapes = play_agent(AgentSpec.parse(agent), unseen, unseen.rooms)
    key = compute_digest({"benchmark": benchmark, "rung": rung, "agent": agent, "rooms": tested})
    return BaselineRun("transfer", rung, name_rooms(benchmark, rung, "test", tested), agent, 0, 0, efficiency, None,
                       escapes, tested, escapes, None, key)


def _play(rooms: UnseenRooms, label: str, agent: Agent) -> tuple[float, float]:
    """Efficiency and escapes of an agent's weights in rooms of any number of buttons."""
    spec = AgentSpec.parse(label)

    def fit(env: gymnasium.Env, recorder: StateRecorder) -> Agent:
        made = make_agent(spec.name, env.observation_space, env.action_space, 0, **spec.settings)
        made.load_state_dict(agent.state_dict())
        return made

    return play_unseen(spec, rooms, fit)


def _compute_key(agent: str, settings: dict[str, Any]) -> str:
    return compute_digest(settings | {"streams": STREAMS, "agent": agent, "settings": AgentSpec.parse(agent).settings})


@lru_cache(maxsize=1)
def _get_seen(benchmark: str, rung: str, count: int) -> UnseenRooms:
    """The first training rooms, to be tested in."""
    return make_unseen(load_benchmark(benchmark)[rung].train[:count])


class Course(NamedTuple):
    """Rooms to be trained in, unseen ones to be tested in by kind, and the first of those trained in."""

    train_in: InstanceSet
    tests: dict[str, UnseenRooms]
    seen: UnseenRooms


@lru_cache(maxsize=1)
def get_course(benchmark: str, course: str, trained: int, tested: int) -> Course:
    """The course of a rung, tested in all rungs of `TRANSFER`, or that of few buttons, tested in `DEPTHS`.

    Args:
        benchmark: name.
        course: name of the rung, or `TRAINED`.
        trained: number of training rooms.
        tested: number of rooms of each kind to be tested in.
    """
    bench = load_benchmark(benchmark)
    if course == TRAINED:
        train_in, sets = make_depth_sets(bench, trained, tested)
        return Course(train_in, {rooms.name: make_unseen(rooms) for rooms in sets}, make_unseen(train_in[:tested]))
    train_in = bench[course].train[:trained]
    return Course(train_in, {rung: get_unseen(benchmark, rung, tested) for rung in TRANSFER},
                  make_unseen(train_in[:tested]))


@lru_cache(maxsize=1)
def _stream_course(benchmark: str, course: str, trained: int, tested: int, agent: str) -> Streams:
    """Rooms to train in, many at once, kept for the next run."""
    return stream_rooms(get_course(benchmark, course, trained, tested).train_in, STREAMS, agent)
