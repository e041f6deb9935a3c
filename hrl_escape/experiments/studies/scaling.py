"""Scaling study: agents in rooms of 2 to 20 buttons, of some dependency graph and violation rule.

Every run has a room of its own and ends early once its agent has solved it (`SolvedRule`). The study is a sequence of
grids, because an agent that never escaped with fewer buttons does not run with more. `scaling_raw.py` keeps the
results, `scaling_page.py` writes the page.

Room, agent, training episodes, checks and stopping are those of version 0.1, so first escapes, recovered graphs and
primitives are equal number by number. `seconds` is now the time of training alone; the published data of 0.1 include
evaluations.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rich.console import Console

from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.experiments.comparison import run_grids
from hrl_escape.experiments.grid import AgentSpec, Grid, OptionsView, SolvedRule
from hrl_escape.experiments.launching.local import LocalLauncher
from hrl_escape.experiments.places import RoomSpec
from hrl_escape.experiments.statistics import NEAR_BEST
from hrl_escape.experiments.studies.running import refuse_failures
from hrl_escape.experiments.studies.scaling_raw import RoomKind, ScalingRun, collect_scaling_runs

__all__ = [
    "AGENTS", "BAR", "BAR_AGENT", "BAR_RUNS", "GRAPHS", "RULES", "SIZES", "Round", "make_room", "run_scaling",
]  # fmt: skip

GRAPHS = ("chain", "tree", "layered", "random")
SIZES = (2, 4, 6, 10, 15, 20)
RULES = ("ignore", "reset")
AGENTS = (
    "smdp-factored-r-max",
    "smdp-monte-carlo-model",
    "smdp-r-max",
    "smdp-q-learning",
    "smdp-intra-option-q",
    "smdp-dqn",
    "smdp-sarsa",
    "smdp-ddpg",
    "smdp-ppo",
    "smdp-random",
)
BAR = (RoomKind("layered", 20, "ignore"), RoomKind("layered", 10, "reset"))
"""Tasks in which factored R-MAX has ten runs: the literature's bar of 10 to 20 buttons modelled within 20,000 steps."""
BAR_AGENT, BAR_RUNS = "smdp-factored-r-max", 10
MAX_PARENTS = 2


@dataclass(frozen=True)
class Round:
    """Runs that may go side by side: one agent with one training seed in several tasks.

    Attributes:
        tasks: the kinds of room.
        agent: name.
        seed: of rooms, agent and episodes.
    """

    tasks: tuple[RoomKind, ...]
    agent: str
    seed: int

    def make_grid(self, primitives: int) -> Grid:
        """The grid of these runs; agents choose options alone."""
        return Grid(
            name=f"scaling--{self.agent}--{self.seed}",
            description="How does learning over options scale with the number of buttons?",
            agents=(AgentSpec(self.agent, options=OptionsView(include_primitives=False)),),
            rooms=tuple(dict(zip(self.rooms.values(), self._specs, strict=True)).values()),
            runs=1,
            first_seed=self.seed,
            primitives=primitives,
            eval_every=primitives,
            eval_episodes=1,  # each room has one start, so all episodes of an evaluation are the same
            until_solved=SolvedRule(score=NEAR_BEST, check_every=500, graph_every=100),
        )


    @cached_property
    def _specs(self) -> tuple[RoomSpec, ...]:
        return tuple(RoomSpec(config=make_room(task).to_dict(), seed=self.seed) for task in self.tasks)

    @cached_property
    def rooms(self) -> dict[RoomKind, str]:
        """Task -> content hash of its room. With two buttons a chain and a tree may be one room, which is run once."""
        return {task: spec.make_instance().id for task, spec in zip(self.tasks, self._specs, strict=True)}


def make_room(task: RoomKind) -> RoomConfig:
    """Room of a task: small buttons anywhere on the walls; 30 m wide from 11 buttons on."""
    size = 20.0 if task.buttons <= 10 else 30.0
    graph = {"kind": task.graph, "max_parents": MAX_PARENTS}
    puzzle = ButtonsConfig.from_dict(
        {"count": task.buttons, "graph": graph, "on_violation": task.rule, "buttons": {"width": 1.5}})
    return RoomConfig(
        name=f"{task.graph}-{task.buttons}-{task.rule}", room=ShapeConfig(width=size, depth=size),
        robot=RobotConfig(body_radius=0.5), puzzle=puzzle,
    )  # fmt: skip


def run_scaling(
    out: Path, runs: int, primitives: int, workers: int | None, minutes: float, console: Console | None = None
) -> list[ScalingRun]:
    """Run what is not finished in a folder: seed by seed, from small rooms to large, agent by agent.

    Args:
        out: the folder of the runs.
        runs: of each agent in each task; those of `BAR` have `BAR_RUNS`.
        primitives: budget of a run.
        workers: runs at a time; None for one a core.
        minutes: begin no run after so long.
        console: where progress is shown; standard error by default.

    Returns:
        All finished runs, also those of earlier calls.

    Raises:
        ComparisonError: a run failed.
        EscapeError: see `run_grid`.
    """
    finished: dict[tuple[RoomKind, str, int], ScalingRun] = {}
    rounds: list[Round] = []

    def make_grids() -> Iterator[Grid]:
        for following in _list_rounds(runs, finished):
            rounds.append(following)
            yield following.make_grid(primitives)

    launcher = LocalLauncher(workers, begin_until=time.monotonic() + 60 * minutes)
    for comparison in run_grids(make_grids(), out, launcher, console):
        refuse_failures(comparison)
        for run in collect_scaling_runs(comparison, rounds[-1].rooms):
            finished[run.task, run.agent, run.run] = run
    return list(finished.values())


def _list_rounds(runs: int, finished: dict[tuple[RoomKind, str, int], ScalingRun]) -> Iterator[Round]:
    """Rounds in order; each depends on what those before have finished."""
    for seed in range(BAR_RUNS):
        yield Round(BAR, BAR_AGENT, seed)
    for seed in range(runs):
        for place, buttons in enumerate(SIZES):
            for agent in AGENTS:
                tasks = []
                for graph in GRAPHS:
                    for rule in RULES:
                        fewer = RoomKind(graph, SIZES[place - 1], rule)
                        smaller = finished.get((fewer, agent, seed)) if place else None
                        if place == 0 or (smaller is not None and smaller.first_escape is not None):
                            tasks.append(RoomKind(graph, buttons, rule))
                if tasks:
                    yield Round(tuple(tasks), agent, seed)
