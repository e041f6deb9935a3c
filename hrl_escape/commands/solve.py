"""Plan an escape from a room, or a path to one goal; run the plan and show it.

    hrl-escape solve --room clutter#3
    hrl-escape solve --room ladder-1/chain/test#5 --json
    hrl-escape solve --room paper-two-button --goal button-2 --draw plan.svg
    hrl-escape solve --room arm-two-button --draw escape.gif
    hrl-escape solve --room push-block --json
    hrl-escape solve --set dynamics.noise=0.1 dynamics.slip=0.1

Under noise, slip or physics, meta-actions run one by one and replan.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.engine import check_camera, film
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.errors import UnsupportedError
from hrl_escape.figures import VIDEO_FORMATS, check_picture_name
from hrl_escape.names import make_console_text
from hrl_escape.options.closed_loop import ClosedLoopExecution, pursue
from hrl_escape.planning.plan import Execution, Plan
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.symbolic.pddl import save_pddl

ESCAPE = "escape"
MOTION_ENDING = "html"


@dataclasses.dataclass(frozen=True)
class SolveArgs(RoomChoice):
    """Options of `hrl-escape solve`."""

    goal: str = ESCAPE
    """Goal: escape, a target's name, exit, or a pose x,y or x,y,heading (degrees)."""
    planner: str = "auto"
    """Method: fields (cost-to-go fields), a path planner such as RRTConnect for the search, or auto."""
    budget: int = 300_000
    """Maximum number of search nodes of one plan; a budget gives the same plan on any machine."""
    episode_seed: int = 0
    """Episode seed: fixes the start and the noise."""
    draw: tuple[Path, ...] = ()
    """Pictures to write: .svg, .pdf or .png for the map with the way, .gif or .mp4 for a video, .html for the plan as
    motion in 3D, under the default limits of speed and acceleration."""
    camera: str = "chase"
    """Camera of videos; `hrl-escape list cameras` names them."""
    pddl: Path | None = None
    """Folder for the puzzle as domain.pddl and problem.pddl."""
    json: bool = False
    """Print JSON instead of tables."""


@dataclasses.dataclass(frozen=True)
class _Outcome:
    """Plan, if one was made in advance, and its execution."""

    plan: Plan | None
    run: Execution | ClosedLoopExecution

    @property
    def is_reached(self) -> bool:
        return self.run.as_predicted if isinstance(self.run, Execution) else self.run.is_reached


def run(args: SolveArgs) -> int:
    """Plan, run and show; the exit code is 1 if the goal was not reached."""
    for path in args.draw:
        check_picture_name(path, *VIDEO_FORMATS, MOTION_ENDING)
    check_camera(args.camera)
    instance = args.make_instance()
    files = list(save_pddl(instance, args.pddl)) if args.pddl else []
    outcome = _solve(args, instance)
    for path in args.draw:
        _draw(path, instance, outcome, args)
    files += args.draw
    report = _describe(instance, args, outcome) | {"files": [str(path) for path in files]}
    print(json.dumps(report, indent=2)) if args.json else _print(report, outcome)
    return 0 if outcome.is_reached else 1


def _solve(args: SolveArgs, instance: RoomInstance) -> _Outcome:
    """Plan and run the plan; replan during execution if the dynamics are uncertain."""
    planner = RoomPlanner(instance, args.planner, args.budget)
    env = EscapeRoomEnv(instance=instance)
    try:
        env.reset(seed=args.episode_seed)
        dynamics = instance.dynamics
        if dynamics.kind == "physics" or dynamics.noise or dynamics.slip:
            return _Outcome(None, pursue(env, None if args.goal == ESCAPE else args.goal, planner))
        state = env.get_state()
        plan = planner.solve(state) if args.goal == ESCAPE else planner.plan(state, args.goal)
        return _Outcome(plan, plan.execute(env))
    finally:
        env.close()


def _describe(instance: RoomInstance, args: SolveArgs, outcome: _Outcome) -> dict[str, Any]:
    executed = outcome.run
    report: dict[str, Any] = {
        "room": instance.name, "seed": instance.seed, "id": instance.id, "goal": args.goal,
        "reached": outcome.is_reached, "escaped": executed.escaped, "end": executed.end.value,
        "primitives": len(executed.rewards), "return": float(sum(executed.rewards)),
    }
    if outcome.plan is not None:
        report["plan"] = outcome.plan.to_dict()
    if isinstance(executed, ClosedLoopExecution):
        report["decisions"] = list(executed.decisions)
    return report


def _print(report: dict[str, Any], outcome: _Outcome) -> None:
    console = Console(soft_wrap=True)
    seed = "" if report["seed"] is None else f", seed {report['seed']}"
    console.print(f"[bold]{make_console_text(report['room'])}[/bold]{seed}, id {report['id']}: "
                  + make_console_text(report["goal"]), "")
    if outcome.plan is not None:
        console.print(_make_plan_table(outcome.plan))
        console.print(f"\nplanned in {1000 * outcome.plan.seconds:.0f} ms, {outcome.plan.expansions} nodes expanded, "
                      f"by {outcome.plan.planner}")
    elif isinstance(outcome.run, ClosedLoopExecution):
        console.print(_make_decision_table(outcome.run))
    decided = outcome.run.end in (EpisodeEnd.ESCAPED, EpisodeEnd.FAILED)
    end = outcome.run.end.words if decided else "reached" if report["reached"] else "not reached"
    exact = ", every state as predicted" if outcome.plan is not None and outcome.is_reached else ""
    console.print(f"run: [bold]{end}[/bold] after {report['primitives']} primitives, return {report['return']:g}"
                  + exact)
    for path in report["files"]:
        console.print(f"wrote {path}", markup=False)


def _make_plan_table(plan: Plan) -> Table:
    header, *rows, total = plan.make_rows()
    table = Table(*header, box=None, padding=(0, 2), pad_edge=False)
    for row in rows:
        table.add_row(*map(make_console_text, row))
    table.add_section()
    table.add_row(*total, style="bold")
    return table


def _make_decision_table(execution: ClosedLoopExecution) -> Table:
    table = Table("option", "primitives", "ended", "plans", "replans", "planning", box=None, padding=(0, 2),
                  pad_edge=False)
    for decision in execution.decisions:
        table.add_row(make_console_text(decision["name"]), str(decision["duration"]), decision["ended"],
                      str(decision["planner_calls"]), str(decision["replans"]),
                      f"{1000 * decision['planner_seconds']:.0f} ms")
    return table


def _draw(path: Path, instance: RoomInstance, outcome: _Outcome, args: SolveArgs) -> None:
    states = outcome.run.states
    if path.suffix.lower() == f".{MOTION_ENDING}":
        from hrl_escape.planning.motion.trajectory import make_trajectory
        from hrl_escape.viewer.pages.offline import save_motion  # needs the extra `viewer`

        if outcome.plan is None:
            raise UnsupportedError(f"{path}: there is no plan to be shown as motion where meta-actions replan on their "
                                   "way; `hrl-escape record` makes a page of an episode")
        save_motion(path, make_trajectory(outcome.plan), instance, states[0])
    elif path.suffix.lower().lstrip(".") in VIDEO_FORMATS:
        from hrl_escape.env.pictures.video import save_video

        save_video(path, film(instance, states, args.camera))
    elif outcome.plan is not None:
        outcome.plan.draw(path)
    else:
        from hrl_escape.env.pictures.maps import Trajectory, save_map  # loads matplotlib

        way = Trajectory([(state.x, state.y) for state in states], f"{len(states) - 1} primitives")
        save_map(path, instance, states[0], [way])
