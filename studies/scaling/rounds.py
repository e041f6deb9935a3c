"""Scaling study: agents in rooms of 2 to 20 buttons, of some dependency graph and violation rule.

Every run has a room of its own and ends early once its agent has solved it (`SolvedRule`). Runs are made in rounds,
because an agent that never escaped with fewer buttons does not run with more. In the rounds of `GIVEN`, factored R-MAX
is given less information than usual.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.score_range import compute_score_range
from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError, ConfigError
from hrl_escape.files import make_folder, read_toml
from hrl_escape.names import make_file_name
from studies.scaling.results import RoomKind, ScalingRun, measure_depth
from studies.scaling.solved_probe import SolvedProbe, SolvedRule

__all__ = [
    "AGENTS", "BAR", "BAR_AGENT", "BAR_RUNS", "FRESH", "GIVEN", "GIVEN_TASKS", "GRAPHS", "HOLDS", "MAX_PARENTS",
    "NEAR_BEST", "RULES", "SIZES", "STUDY_PARTS", "Round", "choose_options", "get_run_folder", "make_room",
    "run_round", "run_scaling",
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
"""Least score of a return near the best known."""
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

    @cached_property
    def rooms(self) -> dict[RoomKind, RoomInstance]:
        """Task -> its room. With two buttons a chain and a tree may be one room, which is run once."""
        return {task: generate(make_room(task), self.seed) for task in self.tasks}


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


def run_scaling(out: Path, runs: int, primitives: int, workers: int | None, minutes: float, first_seed: int = 0,
                parts: Sequence[str] = STUDY_PARTS, agents: Sequence[str] | None = None) -> list[ScalingRun]:
    """Run what is not finished in a folder: seed by seed, from small rooms to large, agent by agent.

    Args:
        out: the folder of the runs.
        runs: of each agent in each task; tasks of `BAR` have `BAR_RUNS`.
        primitives: budget of a run.
        workers: runs at a time; None for one a core.
        minutes: begin no run after so long.
        first_seed: lowest seed of rooms and training.
        parts: of `STUDY_PARTS`.
        agents: of the part `agents`, of `AGENTS`; None for all.

    Returns:
        All finished runs, also from earlier calls.

    Raises:
        ComparisonError: a run failed.
    """
    finished: dict[tuple[RoomKind, str, int], ScalingRun] = {}
    seeds, until = range(first_seed, first_seed + runs), time.monotonic() + 60 * minutes
    for following in _list_rounds(seeds, first_seed, parts, agents or AGENTS, finished):
        for run in run_round(following, out, primitives, workers, until):
            finished[run.place] = run
    return list(finished.values())


def run_round(part: Round, out: Path, primitives: int, workers: int | None = None, until: float = float("inf"),
              checkpoint_seconds: float = 30.0) -> list[ScalingRun]:
    """Make the runs of a round, each in a process; finished ones in the folder are read.

    Args:
        part: the round.
        out: folder of the runs; a run that was stopped resumes from its checkpoint there.
        primitives: budget of a run.
        workers: runs at a time; None for one a core.
        until: begin no run after this time of the monotonic clock.
        checkpoint_seconds: between checkpoints.

    Raises:
        ComparisonError: a run failed.
    """
    if workers is not None and workers < 1:
        raise ConfigError("workers", workers, "at least 1")
    make_folder(out)
    found = []
    with ProcessPoolExecutor(workers, get_fork_server()) as pool:
        rooms: dict[str, list[RoomKind]] = {}
        for task, room in part.rooms.items():
            rooms.setdefault(room.id, []).append(task)
        jobs = [(tasks, spec, pool.submit(run_once, tasks[0], spec, part.seed, primitives, out, until,
                                          checkpoint_seconds))
                for spec in part.agents for tasks in rooms.values()]
        for tasks, spec, job in jobs:
            try:
                run = job.result()
            except Exception as error:
                raise ComparisonError(f"{spec.label} in {tasks[0]}, seed {part.seed}, failed: {error}. The same "
                                      "command tries it again") from error
            if run is not None:
                found += [dataclasses.replace(run, graph=task.graph, rule=task.rule) for task in tasks]
                print(f"{run.agent}, {', '.join(map(str, tasks[0]))}, seed {run.run}: {run.primitives} primitives",
                      file=sys.stderr)
    return found


def get_run_folder(out: Path, room: RoomInstance, spec: AgentSpec, seed: int) -> Path:
    """Folder of a run's training; `train` puts the key of the run in its name."""
    return out / make_file_name(f"{spec.label}--{room.name}--seed-{seed}--{room.id[:6]}")


def run_once(task: RoomKind, spec: AgentSpec, seed: int, primitives: int, out: Path, until: float,
             checkpoint_seconds: float) -> ScalingRun | None:
    """Train an agent in a room until it has solved it; None for a run that begins after `until`."""
    room = generate(make_room(task), seed)
    folder = get_run_folder(out, room, spec, seed)
    if time.monotonic() > until and not (folder / "result.json").exists():
        return None
    env, recorder = make_agent_env(spec, room, "features")
    try:
        # A room has one start, so all episodes of an evaluation are the same: one is enough.
        starts = find_starts(env, recorder, [compute_episode_seed(seed, "evaluation", 0)])
        score_range = compute_score_range(starts, spec, out / "references")
        probe = SolvedProbe(SolvedRule(NEAR_BEST), env, room, spec, score_range)
        result = train(
            AgentSpec(spec.name, options=OptionsView(include_primitives=False)), env, primitives=primitives, seed=seed,
            settings=spec.resolve_settings(), eval_every=primitives, eval_episodes=1, eval_seed=seed, out=folder,
            checkpoint_seconds=checkpoint_seconds, progress=False, probe=probe, observed=False)
    finally:
        env.close()
    return ScalingRun(
        *task, agent=spec.label, run=seed, room=room.id, best=sum(score_range.reachable), worst=score_range.worst,
        budget=primitives, primitives=result.primitives, decisions=result.decisions, seconds=round(result.seconds, 1),
        first_escape=result.first_escape, **vars(probe.solution), depth=measure_depth(room))


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
