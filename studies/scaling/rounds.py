"""Scaling study: agents in rooms of 2 to 20 buttons, of some dependency graph and violation rule.

Every run has a room of its own and ends early once its agent has solved it (`SolvedRule`). The study is a sequence of
grids, because an agent that never escaped with fewer buttons does not run with more. Apart from these, factored R-MAX
is given less than it usually is (`GIVEN`).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.console import Console

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.grid import Grid, SolvedRule
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.files import read_toml
from hrl_escape.sets.room_spec import RoomSpec
from studies.running import refuse_failures
from studies.scaling.results import RoomKind, ScalingRun, collect_scaling_runs

__all__ = [
    "AGENTS", "BAR", "BAR_AGENT", "BAR_RUNS", "FRESH", "GIVEN", "GIVEN_TASKS", "GRAPHS", "HOLDS", "MAX_PARENTS",
    "NEAR_BEST", "RULES", "SIZES", "STUDY_PARTS", "Round", "choose_options", "make_room", "run_scaling",
]  # fmt: skip

_DATA = read_toml(Path(__file__).with_name("study.toml"))
GRAPHS: tuple[str, ...] = tuple(_DATA["graphs"])
SIZES: tuple[int, ...] = tuple(_DATA["sizes"])
RULES: tuple[str, ...] = tuple(_DATA["rules"])
AGENTS: tuple[str, ...] = tuple(_DATA["agents"])
BAR = tuple(RoomKind(*kind) for kind in _DATA["bar"]["rooms"])
BAR_AGENT: str = _DATA["bar"]["agent"]
BAR_RUNS: int = _DATA["bar"]["runs"]
MAX_PARENTS: int = _DATA["max_parents"]
NOISE = ", noise"
NEAR_BEST = 0.95
"""Score from which on a return counts as near the best known."""
STUDY_PARTS = ("bar", "told", "agents")
FRESH = 100
"""First seed of runs that are held against the published ones."""


def choose_options(name: str, label: str = "", **settings: Any) -> AgentSpec:
    """An agent that chooses among options alone."""
    return AgentSpec(name, label or name, settings=settings, options=OptionsView(include_primitives=False))


GIVEN = tuple(choose_options(BAR_AGENT, f"{conditions}, {most}", max_parents=most, conditions=conditions)
             for conditions in _DATA["told"]["conditions"] for most in _DATA["told"]["parents"])
GIVEN_TASKS = tuple(RoomKind(*kind) for kind in _DATA["told"]["rooms"])
HOLDS = f"all-on, {MAX_PARENTS}"
"""Label of the learner that is given just what holds in these rooms."""


@dataclass(frozen=True)
class Round:
    """Runs that may go side by side: agents with one training seed in several tasks.

    Attributes:
        tasks: the kinds of room.
        agents: those that choose options.
        seed: of rooms, agents and episodes.
    """

    tasks: tuple[RoomKind, ...]
    agents: tuple[AgentSpec, ...]
    seed: int

    def make_grid(self, primitives: int) -> Grid:
        """The grid of these runs."""
        ids = [room.id for room in self.rooms.values()]
        return Grid(
            name=f"scaling--{self.agents[0].label if len(self.agents) == 1 else 'told'}--{self.seed}",
            description="How does learning over options scale with the number of buttons?",
            agents=self.agents,
            rooms=tuple(dict(zip(ids, self._specs, strict=True)).values()),
            runs=1,
            first_seed=self.seed,
            primitives=primitives,
            eval_every=primitives,
            eval_episodes=1,  # each room has one start, so all episodes of an evaluation are the same
            until_solved=SolvedRule(score=NEAR_BEST, check_every=500, graph_every=100),
        )

    @cached_property
    def _specs(self) -> tuple[RoomSpec, ...]:
        return tuple(RoomSpec(config=make_room(task).to_dict(), instance=self.seed) for task in self.tasks)

    @cached_property
    def rooms(self) -> dict[RoomKind, RoomInstance]:
        """Task -> its room. With two buttons a chain and a tree may be one room, which is run once."""
        return {task: spec.make_instance() for task, spec in zip(self.tasks, self._specs, strict=True)}


def make_room(task: RoomKind, width: float | None = None) -> RoomConfig:
    """Room of a task: small buttons anywhere on the walls; by default 20 m wide, and 30 m from 11 buttons on."""
    size = width or (20.0 if task.buttons <= 10 else 30.0)
    rule = task.rule.removesuffix(NOISE)
    graph = {"kind": task.graph, "max_parents": MAX_PARENTS}
    puzzle = ButtonsConfig.from_dict(
        {"count": task.buttons, "graph": graph, "on_violation": rule, "buttons": {"width": 1.5}})
    room = RoomConfig(
        name=f"{task.graph}-{task.buttons}-{rule}", room=ShapeConfig(width=size, depth=size),
        robot=RobotConfig(body_radius=0.5), puzzle=puzzle,
    )  # fmt: skip
    if task.rule == rule:
        return room
    return dataclasses.replace(room, name=f"{room.name}-noise", dynamics=DynamicsConfig(noise=0.1, slip=0.1))


def run_scaling(
    out: Path, runs: int, primitives: int, workers: int | None, minutes: float, console: Console | None = None,
    first_seed: int = 0, parts: Sequence[str] = STUDY_PARTS, agents: Sequence[str] | None = None,
) -> list[ScalingRun]:
    """Run what is not finished in a folder: seed by seed, from small rooms to large, agent by agent.

    Args:
        out: the folder of the runs.
        runs: of each agent in each task; those of `BAR` have `BAR_RUNS`.
        primitives: budget of a run.
        workers: runs at a time; None for one a core.
        minutes: begin no run after so long.
        console: where progress is shown; standard error by default.
        first_seed: lowest seed of rooms and training.
        parts: of `STUDY_PARTS`.
        agents: of the part `agents`, of `AGENTS`; None for all.

    Returns:
        All finished runs, also those of earlier calls.

    Raises:
        ComparisonError: a run failed.
        EscapeError: see `run_grid`.
    """
    finished: dict[tuple[RoomKind, str, int], ScalingRun] = {}
    seeds = range(first_seed, first_seed + runs)
    launcher = LocalLauncher(workers, begin_until=time.monotonic() + 60 * minutes)
    for following in _list_rounds(seeds, first_seed, parts, agents or AGENTS, finished):
        comparison = run_grid(following.make_grid(primitives), out, launcher, console)
        refuse_failures(comparison)
        for run in collect_scaling_runs(comparison, following.rooms):
            finished[run.task, run.agent, run.run] = run
    return list(finished.values())


def _list_rounds(seeds: Sequence[int], first_seed: int, parts: Sequence[str], agents: Sequence[str],
                 finished: dict[tuple[RoomKind, str, int], ScalingRun]) -> Iterator[Round]:
    """Rounds in order; each depends on what those before have finished."""
    if "bar" in parts:
        for seed in range(first_seed, first_seed + BAR_RUNS):
            yield Round(BAR, (choose_options(BAR_AGENT),), seed)
    if "told" in parts:
        for seed in seeds:
            yield Round(GIVEN_TASKS, GIVEN, seed)
    for seed in seeds if "agents" in parts else ():
        for place, buttons in enumerate(SIZES):
            for agent in agents:
                tasks = []
                for graph in GRAPHS:
                    for rule in RULES:
                        fewer = RoomKind(graph, SIZES[place - 1], rule)
                        smaller = finished.get((fewer, agent, seed)) if place else None
                        if place == 0 or (smaller is not None and smaller.first_escape is not None):
                            tasks.append(RoomKind(graph, buttons, rule))
                if tasks:
                    yield Round(tuple(tasks), (choose_options(agent),), seed)
