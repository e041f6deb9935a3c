"""Runs of the baselines, agent by agent and rung by rung, so that however short the time, whole cells are finished."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison, read_comparison, run_grid
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.local import Failure, LocalLauncher
from hrl_escape.benchmark.protocols import (
    SEQUENCE,
    LadderSettings,
    Protocol,
    choose_sequence,
    make_protocol_grid,
    make_sequence_grid,
)
from hrl_escape.files import read_toml
from hrl_escape.sets.benchmark import Benchmark
from studies.baseline import BaselineRun, collect_baselines
from studies.running import NO_TRAINING, GridArgs

__all__ = ["SEQUENCE_AGENTS", "GENERALISTS", "LEARNERS", "BaselineArgs", "collect_lines", "list_missing",
           "make_baseline_grids", "run_baselines"]

_DATA = read_toml(Path(__file__).with_name("study.toml"))
LEARNERS = (*_DATA["references"], *_DATA["agents"]["per-instance"])
"""Agents that learn a room from nothing, and references."""
GENERALISTS = (*_DATA["references"], *_DATA["agents"]["generalise"])
"""Agents that learn in some rooms and act in others, and references."""
SEQUENCE_AGENTS = (*_DATA["sequence"]["references"], *_DATA["agents"]["generalise"])
"""Agents in a sequence of rooms, and references."""


class BaselinePlace(NamedTuple):
    """Protocol, rung, and `references` or `learners`."""

    protocol: Protocol
    rung: str
    kind: str


@dataclasses.dataclass(frozen=True)
class BaselineArgs(GridArgs):
    """Choice of baselines, and the number of runs of each."""

    rung: tuple[str, ...] = ()
    """Names of rungs; all by default."""
    protocol: tuple[Literal["per-instance", "generalise", "sequence"], ...] = ("per-instance", "generalise")
    """Protocols."""
    agents: tuple[str, ...] = ()
    """Agents, as for `hrl-escape ladder run`; the agents of the protocol by default."""
    rooms: int = 10
    """Test rooms of each rung."""
    runs: int = 10
    """Training seeds in each room."""
    primitives: int | None = None
    """Training budget of a run; the rung's own by default."""
    eval_episodes: int = 20
    """Episodes in an evaluation with per-instance."""
    minutes: float = 240.0
    """Begin no run after so long."""


def make_baseline_grids(bench: Benchmark, args: BaselineArgs) -> Iterator[tuple[BaselinePlace, Grid]]:
    """Yield places and grids; a grid of more agents and seeds holds the runs of the smaller ones before it.

    An agent goes through all rooms of all rungs before the next one, so that what is finished is whole cells.
    References have grids of their own, where training is cut short.

    Raises:
        EscapeError: no such rung or agent.
    """
    chosen = [bench[name].name for name in args.rung] or [rung.name for rung in bench]
    defaults = {"per-instance": LEARNERS, "generalise": GENERALISTS, SEQUENCE: SEQUENCE_AGENTS}
    for runs, protocol in itertools.product(range(1, args.runs + 1), args.protocol):
        alone, rungs = protocol == "per-instance", [SEQUENCE] if protocol == SEQUENCE else chosen
        every = tuple(map(AgentSpec.parse, args.agents or defaults[protocol]))
        for kind, primitives in (("references", NO_TRAINING), ("learners", args.primitives)):
            agents = [agent for agent in every if agent.learns == (kind == "learners")]
            settings = LadderSettings(runs, primitives, args.rooms, first_seed=args.first_seed,
                                      eval_episodes=args.eval_episodes if alone else args.rooms)
            for count, rung in itertools.product(range(1, len(agents) + 1), rungs):
                grid = (make_sequence_grid(bench, args.rung or choose_sequence(bench), agents[:count], settings)
                        if protocol == SEQUENCE else
                        make_protocol_grid(bench, rung, protocol, agents[:count], settings))
                yield BaselinePlace(protocol, rung, kind), grid


def run_baselines(bench: Benchmark, args: BaselineArgs) -> dict[BaselinePlace, Comparison]:
    """Make runs until all are made or the time is up; finished ones are kept, in the folder `ladder` of `args.out`.

    Returns:
        Whole comparison of each place, with the runs that have finished and those that failed now.

    Raises:
        EscapeError: see `run_grid`.
    """
    until, out, whole = time.monotonic() + 60 * args.minutes, args.out / "ladder", {}
    failures: dict[BaselinePlace, dict[str, Failure]] = defaultdict(dict)
    for place, grid in make_baseline_grids(bench, args):
        whole[place] = grid  # the last one holds the runs of all others
        if time.monotonic() < until:
            made = run_grid(grid, out.joinpath(*place), LocalLauncher(args.workers, begin_until=until))
            failures[place].update((failure.run.folder, failure) for failure in made.failures)
    return {place: dataclasses.replace(read_comparison(out.joinpath(*place), grid),
                                       failures=tuple(failures[place].values())) for place, grid in whole.items()}


def collect_lines(found: dict[BaselinePlace, Comparison]) -> list[BaselineRun]:
    """Lines of all finished runs."""
    return [line for place, comparison in found.items()
            for line in collect_baselines(comparison, place.protocol, place.rung)]


def list_missing(found: dict[BaselinePlace, Comparison]) -> int:
    """Number of runs that are still to be made."""
    return sum(len(comparison.grid.make_runs(comparison.places)) - len(comparison.runs)
               for comparison in found.values())
