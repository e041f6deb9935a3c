"""Learners at the budgets of the ladder's rungs, with the references of the ladder's own study."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, TypeAlias

from studies.unseen import UnseenRooms, make_unseen, play_unseen, stream_rooms, train_agent

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.protocols import get_budget
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from studies.baseline import BaselineRun, compute_run_efficiency
from studies.ladder.analysis import (
    compare_with_search,
    draw_rungs,
    group_runs,
    subtract,
    tabulate,
    tabulate_beyond,
    tabulate_labels,
)
from studies.ladder.calibration import KNOWN, Cells
from studies.running import StudyArgs, open_store
from studies.statistics import Difference, compare_strata
from studies.store import Store
from studies.study import Findings, Study, find_study

__all__ = ["Args", "analyse", "compare_budgets", "measure", "run_once"]

LINES = (BaselineRun,)
PROTOCOL = "per-instance"
Job: TypeAlias = tuple[str, int, str, int]
"""Rung, number of the room, agent, and training seed."""


@dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    rungs: tuple[str, ...] = ()
    """Rungs that are run; all by default."""
    agents: tuple[str, ...] = ()
    """Agents to run, by label; all by default."""
    rooms: int | None = None
    """Rooms of each rung; those of `study.toml` by default."""
    runs: int | None = None
    """Training seeds in each room; those of `study.toml` by default."""
    primitives: int | None = None
    """Training budget; each rung's own by default."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    minutes: float = float("inf")
    """Minutes after which no further run is begun."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Make the runs that are missing, seed by seed; a line is kept as soon as its run is done.

    Raises:
        UnknownNameError: no such agent or rung.
    """
    data, until = study.data, time.monotonic() + 60 * args.minutes
    for what, chosen, every in (("agent", args.agents, list(data["agents"])),
                                ("rung", args.rungs, [rung.name for rung in load_benchmark(data["benchmark"])])):
        if unknown := [name for name in chosen if name not in every]:
            raise UnknownNameError(f"{what} of this study", unknown[0], every)
    there = {(line.place, line.key) for line in store.load()}
    jobs = [(rung, room, agent, seed) for seed in range(args.runs or data["runs"])
            for rung in args.rungs or data["rungs"] for agent in args.agents or data["agents"]
            for room in range(args.rooms or data["rooms"])
            if identify(data, rung, room, agent, seed, args.primitives or get_budget(rung)) not in there]
    with ProcessPoolExecutor(args.workers, get_fork_server()) as pool:
        for number, line in enumerate(_run(pool, study, args, jobs, until), 1):
            store.add([line])
            print(f"[{number}/{len(jobs)}] {line.agent}, {line.rooms}, seed {line.seed}: {line.efficiency:.3f}",
                  file=sys.stderr)


def _run(pool: ProcessPoolExecutor, study: Study, args: Args, jobs: Sequence[Job], until: float
         ) -> Iterator[BaselineRun]:
    """Results of jobs as they come; those that have not begun in time are left out."""
    waiting = [pool.submit(run_once, dict(study.data), *job, args.primitives or get_budget(job[0]), until)
               for job in jobs]
    for done in as_completed(waiting):
        if (line := done.result()) is not None:
            yield line


def run_once(data: Mapping[str, Any], rung: str, number: int, agent: str, seed: int, primitives: int,
             until: float = float("inf")) -> BaselineRun | None:
    """Train an agent in copies of a room, and play the room; None after `until`, by the monotonic clock."""
    if time.monotonic() > until:
        return None
    spec = AgentSpec.parse(agent)
    observation = "objects" if spec.settings.get("network") == "objects" else "features"
    room = load_benchmark(data["benchmark"])[rung].test[number : number + 1]
    player, first_escape = train_agent(spec, stream_rooms(room, data["copies"], agent, observation), primitives, seed)
    efficiency, escapes = play_unseen(spec, UnseenRooms(room, make_unseen(room).fewest * data["episodes"]),
                                      lambda env, recorder: player, observation)
    place, key = identify(data, rung, number, agent, seed, primitives)
    return BaselineRun(*place, efficiency, None, escapes, data["episodes"], escapes, first_escape, key)


@cache
def get_room_id(benchmark: str, rung: str, number: int) -> str:
    """Content id of a test room, which is sampled once for all its runs."""
    return load_benchmark(benchmark)[rung].test[number].id


def identify(data: Mapping[str, Any], rung: str, number: int, agent: str, seed: int, primitives: int
             ) -> tuple[tuple[str, str, str, str, int, int], str]:
    """Place of a run among the lines, and the hash of everything that decides its numbers."""
    key = compute_digest({
        "room": get_room_id(data["benchmark"], rung, number), "agent": agent,
        "settings": AgentSpec.parse(agent).settings, "seed": seed, "primitives": primitives, "copies": data["copies"],
        "episodes": data["episodes"]})
    return (PROTOCOL, rung, f"{data['benchmark']}/{rung}/test#{number}", agent, seed, primitives), key


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Comparisons with the best search baseline and with smaller budgets; references are those of the ladder study."""
    rungs = [rung for rung in study.data["rungs"] if any(line.rung == rung for line in lines)]
    known = [line for line in open_store(find_study("ladder"), None).load() if isinstance(line, BaselineRun)
             and line.protocol == PROTOCOL and line.rung in rungs and line.primitives < get_budget(line.rung)
             and (line.agent == KNOWN or AgentSpec.parse(line.agent).chooses_options)]
    lines = [line for line in lines if line.primitives == get_budget(line.rung)]
    cells = group_runs([*(line for line in known if not line.primitives), *lines])
    beyond = compare_with_search(cells, rungs)
    return Findings(SimpleNamespace(
        runs=len(lines), rungs=rungs, beyond=beyond, more=compare_budgets(cells, group_runs(known), rungs),
        means={agent: {rung: compute_run_efficiency(cells[rung, agent]) for rung in rungs if (rung, agent) in cells}
               for agent in study.data["agents"]},
        seeds=max((len({line.seed for line in runs}) for (_, agent), runs in cells.items()
                   if agent in study.data["agents"]), default=0),
        copies=study.data["copies"], episodes=study.data["episodes"]), {
            "budgets": tabulate(cells, rungs), "budgets_labels": tabulate_labels(cells),
            "budgets_beyond": tabulate_beyond(beyond)},
        {"budgets": partial(draw_rungs, cells, rungs, list(study.data["agents"]))})


def compare_budgets(cells: Cells, former: Cells, rungs: Sequence[str]) -> dict[str, Difference]:
    """Gain of learners over the same ones with fewer primitives, in the same rooms, with rungs as strata (Holm)."""
    gains = {agent: found for agent in dict.fromkeys(agent for _, agent in cells) if (found := [
        gain for rung in rungs if any(run.primitives for run in former.get((rung, agent), ()))
        and len(gain := subtract(cells.get((rung, agent), ()), former[rung, agent])) >= LEAST_RUNS])}
    return dict(zip(gains, compare_strata(list(gains.values())), strict=True))
