"""Scaling study: agents in rooms of 2 to 20 buttons, of some dependency graph and violation rule.

Every run has a room of its own and ends early once its agent has solved it (`SolvedProbe`). Runs are made in rounds,
because an agent that never escaped with fewer buttons does not run with more. In the rounds of `GIVEN`, factored R-MAX
is given less information than usual.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.score_range import compute_score_range
from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.files import read_toml
from studies.scaling.results import RoomKind, ScalingRun, measure_depth
from studies.scaling.solved_probe import SolvedProbe
from studies.store import Store

__all__ = ["AGENTS", "BAR", "BAR_AGENT", "BAR_RUNS", "FRESH", "GIVEN", "GIVEN_TASKS", "HOLDS", "RULES", "SIZES",
           "STUDY_PARTS", "choose_options", "make_room", "run_once", "run_scaling"]

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


def run_scaling(store: Store, args: Any) -> None:
    """Run what a store lacks, in rounds of runs that go side by side, and keep each line at once.

    An agent that never escaped with fewer buttons (same graph, rule and seed) does not run with more.

    Args:
        store: of the lines.
        args: of the study.
    """
    runs, end = {run.place: run for run in store.load()}, time.monotonic() + 60 * args.minutes
    with ProcessPoolExecutor(args.workers, get_fork_server()) as pool:
        for jobs in _list_rounds(args, runs):
            begun = [pool.submit(run_once, *job, args.primitives, args.out, end) for job in jobs
                     if (job[0], job[1].label, job[2]) not in runs]
            for job in as_completed(begun):
                if (run := job.result()) is not None:
                    runs[run.place] = run
                    store.add([run])
                    print(f"{run.agent}, {', '.join(map(str, run.task))}, seed {run.run}: {run.primitives} primitives",
                          file=sys.stderr)


def run_once(task: RoomKind, spec: AgentSpec, seed: int, primitives: int, out: Path, end: float) -> ScalingRun | None:
    """Train an agent in a room until it has solved it; None after the end, a time of the monotonic clock."""
    if time.monotonic() > end:
        return None
    room = generate(make_room(task), seed)
    env, recorder = make_agent_env(spec, room, "features")
    try:
        # A room has one start, so all episodes of an evaluation are the same: one is enough.
        starts = find_starts(env, recorder, [compute_episode_seed(seed, "evaluation", 0)])
        score_range = compute_score_range(starts, spec, out / "scaling" / "references")
        probe = SolvedProbe(NEAR_BEST, env, room, spec, score_range)
        result = train(
            AgentSpec(spec.name, options=OptionsView(include_primitives=False)), env, primitives=primitives, seed=seed,
            settings=spec.resolve_settings(), eval_every=primitives, eval_episodes=1, eval_seed=seed, progress=False,
            probe=probe, observed=False)
    finally:
        env.close()
    return ScalingRun(
        *task, agent=spec.label, run=seed, room=room.id, best=sum(score_range.reachable), worst=score_range.worst,
        budget=primitives, primitives=result.primitives, decisions=result.decisions, seconds=round(result.seconds, 1),
        first_escape=result.first_escape, near_best=probe.near_best, edges=probe.edges, depth=measure_depth(room),
        structure=tuple(probe.structure))


def _list_rounds(args: Any, runs: Mapping[tuple[RoomKind, str, int], ScalingRun]
                 ) -> Iterator[list[tuple[RoomKind, AgentSpec, int]]]:
    """Rounds in order; each depends on what those before have added to the runs."""
    seeds = range(args.first_seed, args.first_seed + args.runs)
    if "bar" in args.parts:
        for seed in range(args.first_seed, args.first_seed + BAR_RUNS):
            yield [(task, choose_options(BAR_AGENT), seed) for task in BAR]
    if "told" in args.parts:
        for seed in seeds:
            yield [(task, spec, seed) for task in GIVEN_TASKS for spec in GIVEN]
    for seed in seeds if "agents" in args.parts else ():
        for fewer, buttons in zip((None, *SIZES), SIZES, strict=False):
            for agent in args.agents:
                yield [(RoomKind(graph, buttons, rule), choose_options(agent), seed) for graph in GRAPHS
                       for rule in RULES if fewer is None
                       or ((run := runs.get((RoomKind(graph, fewer, rule), agent, seed))) and run.first_escape)]
