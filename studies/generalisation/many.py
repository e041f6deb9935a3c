"""The learner with a memory at the budget of the rung, from many rooms at once, tested in rooms it never saw."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.agents.training.train import train
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.launching.local import get_fork_server
from hrl_escape.ladder.benchmark import load_benchmark
from studies.baseline import BaselineRun
from studies.generalisation.grids import MANY, MEMORY
from studies.unseen import UnseenRooms, get_unseen, make_streams, make_unseen, play_unseen

__all__ = ["measure_many", "run_many"]

STREAMS = 256
"""Rooms that it learns from at once; with fewer training rooms, several are the same."""


def measure_many(benchmark: str, rung: str, jobs: Sequence[tuple[int, int]], primitives: int, tested: int, workers: int
                 ) -> Iterator[BaselineRun]:
    """Make runs, and give each as soon as it is done.

    Args:
        benchmark: name.
        rung: name.
        jobs: number of training rooms, and seed, of each run.
        primitives: of a run, in all rooms together.
        tested: number of unseen rooms, an episode in each.
        workers: processes.
    """
    with ProcessPoolExecutor(workers, get_fork_server()) as pool:
        for done in as_completed([pool.submit(run_many, benchmark, rung, *job, primitives, tested) for job in jobs]):
            yield done.result()


def run_many(benchmark: str, rung: str, size: int, seed: int, primitives: int, tested: int) -> BaselineRun:
    """One run; see `measure_many`."""
    spec, streams = AgentSpec.parse(MEMORY), make_streams(benchmark, rung, size, STREAMS)
    settings = {"benchmark": benchmark, "rung": rung, "rooms": size, "seed": seed, "primitives": primitives,
                "streams": STREAMS, "settings": spec.settings}
    result = train(spec.name, streams, primitives=primitives, seed=seed, settings=spec.settings, eval_episodes=0,
                   progress=False)
    agent = result.agent
    assert agent is not None  # a run without a folder gives its agent back
    (unseen, escapes), (seen, _) = (_play(spec, rooms, agent) for rooms in (
        get_unseen(benchmark, rung, tested), _get_seen(benchmark, rung, min(size, tested))))
    place = f"{benchmark}/{rung}"
    return BaselineRun("sizes", rung, f"{place}/train[:{size}] > {place}/test[:{tested}]", MANY, seed, primitives,
                       unseen, seen, escapes, tested, escapes, result.first_escape, compute_digest(settings))


def _play(spec: AgentSpec, rooms: UnseenRooms, agent: Agent) -> tuple[float, float]:
    return play_unseen(spec, rooms, lambda env, recorder: agent)


@lru_cache(maxsize=1)
def _get_seen(benchmark: str, rung: str, count: int) -> UnseenRooms:
    """The first training rooms, to be tested in."""
    return make_unseen(load_benchmark(benchmark)[rung].train[:count])
