"""All planners on the same queries: number of primitives beside a near-exact reference, and time. Not a command.

The idea is OMPL's Planner Arena (Moll, Sucan and Kavraki 2015). Queries are drawn without any
planner's help: from certified free places of generated rooms to the rooms' own goals. Measured
are the search along cached fields and the corridor search round each path planner's path.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from hrl_escape.env.config import ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.free_space import FreeSpace
from hrl_escape.env.sampling.generation import generate
from hrl_escape.files import write_text
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal, describe_goal, is_reached
from hrl_escape.planning.lattice.areas import compute_goal_area
from hrl_escape.planning.lattice.reference import find_fewest_primitives
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER
from hrl_escape.planning.paths.registry import list_planners
from hrl_escape.planning.primitive_search import PrimitiveSearch

__all__ = ["FIELDS", "FLOORS", "QueryResult", "Query", "Score", "draw_scores", "list_contenders", "make_queries",
           "measure", "score_contenders", "write_csv"]

FIELDS = "fields"
"""Name of the contender that needs no path planner."""


def _floor(obstacles: int, rooms: int, largest: float = 2.0) -> RoomConfig:
    return RoomConfig(
        room=ShapeConfig(rooms=rooms), robot=RobotConfig(body_radius=0.5),
        puzzle=ButtonsConfig(count=3, buttons=Panels(width=1.5)),
        obstacles=ObstaclesConfig(count=obstacles, size_max=largest),
    )


FLOORS = {
    "empty": _floor(0, 1),
    "10 obstacles": _floor(10, 1),
    "40 obstacles": _floor(40, 1, 1.5),
    "interior walls": _floor(15, 3),
}
"""Schematics, 20 x 20 m each, on which planners are compared."""


@dataclasses.dataclass(frozen=True)
class Query:
    """One query and the reference's answer.

    Attributes:
        floor: name of the schematic.
        search: primitive search of the room.
        state: first state.
        goal: the goal.
        fewest: number of primitives that the near-exact reference needs.
    """

    floor: str
    search: PrimitiveSearch
    state: RoomState
    goal: Goal
    fewest: int


@dataclasses.dataclass(frozen=True)
class QueryResult:
    """Result of one contender on one query.

    Attributes:
        contender: `FIELDS` or a path planner.
        floor: name of the schematic.
        instance: id of the room.
        goal: the goal in words.
        reached: the goal was reached, confirmed by replay, without falling back on another contender.
        primitives: number of primitives.
        fewest: number of primitives of the reference.
        milliseconds: wall time, without preparing the room.
    """

    contender: str
    floor: str
    instance: str
    goal: str
    reached: bool
    primitives: int
    fewest: int
    milliseconds: float


@dataclasses.dataclass(frozen=True)
class Score:
    """Summary of a contender on one floor; ratios are to the reference, over the goals that it reached."""

    contender: str
    floor: str
    queries: int
    success: float
    primitives: float
    ratio: float
    ratio_p95: float
    median_ms: float
    p99_ms: float


def list_contenders() -> tuple[str, ...]:
    """All contenders: `FIELDS` and every path planner."""
    return (FIELDS, *list_planners())


def make_queries(floor: str, seeds: Iterable[int], each: int, config: RoomConfig | None = None) -> list[Query]:
    """Draw queries and answer them with the reference.

    Args:
        floor: one of `FLOORS`, or any name if `config` is given.
        seeds: instance seeds, one room each.
        each: number of queries in a room; their goals cycle through its buttons and exit.
        config: another schematic; its buttons are pressed by the body and its exit has no door.
    """
    queries: list[Query] = []
    for seed in seeds:
        instance = generate(config or FLOORS[floor], seed)
        search = PrimitiveSearch(instance)
        rules, rng = search.kinematics, np.random.default_rng([seed, 3])
        space = FreeSpace(instance.reach_x, instance.reach_y, instance.robot.body_radius, instance.solids)
        begin = rules.make_state(instance.starts[0])
        cells = space.get_cells(space.find_label(begin.x, begin.y))
        goals: list[Goal] = [*(PressGoal(i) for i in range(len(instance.targets))), ExitGoal()]
        for number in range(each):
            goal = goals[number % len(goals)]
            state = _draw_state(rules, space, cells, begin, goal, rng)
            found = find_fewest_primitives(rules, state, goal, *compute_goal_area(goal, instance))
            if found is not None:
                queries.append(Query(floor, search, state, goal, len(found)))
    return queries


def _draw_state(rules: Kinematics, space: FreeSpace, cells: np.ndarray, begin: RoomState, goal: Goal,
                rng: np.random.Generator) -> RoomState:
    """Draw a free place and a heading at which the goal is not reached yet."""
    while True:
        x, y = space.get_centres(cells[rng.integers(len(cells))]).tolist()
        heading = int(rng.integers(rules.headings))
        touching = rules.compute_touching(x, y, heading, 0.0, begin.joint_steps, ())
        state = begin._replace(x=x, y=y, heading_steps=heading, touching=touching)
        if not touching and not is_reached(goal, state, state, rules):
            return state


def measure(queries: Sequence[Query], contenders: Sequence[str],
            report: Callable[[str], None] = lambda _: None) -> list[QueryResult]:
    """Run every contender on every query; preparation in a room is not timed.

    Args:
        queries: from `make_queries`.
        contenders: some of `list_contenders()`.
        report: called with each contender's name before its turn at a query.
    """
    rows: list[QueryResult] = []
    prepared: set[tuple[str, int]] = set()
    for query in queries:
        for contender in contenders:
            report(contender)
            planner = DEFAULT_PLANNER if contender == FIELDS else contender
            method = "fields" if contender == FIELDS else "corridor"
            if (contender, id(query.search)) not in prepared:
                prepared.add((contender, id(query.search)))
                query.search.prepare()
                query.search.search(query.state, query.goal, method=method, planner=planner)
            began = time.perf_counter()
            result = query.search.search(query.state, query.goal, method=method, planner=planner)
            seconds = time.perf_counter() - began
            instance = query.search.instance
            rows.append(QueryResult(
                contender, query.floor, instance.id, describe_goal(query.goal, instance),
                result.is_reached and result.method == contender, len(result.primitives), query.fewest, 1e3 * seconds,
            ))
    return rows


def score_contenders(rows: Sequence[QueryResult]) -> list[Score]:
    """One score for each contender and floor, in the order of the measurements."""
    groups: dict[tuple[str, str], list[QueryResult]] = {}
    for row in rows:
        groups.setdefault((row.floor, row.contender), []).append(row)
    scores = []
    for (floor, contender), group in groups.items():
        reached = [row for row in group if row.reached]
        ratios = np.array([row.primitives / row.fewest for row in reached] or [np.nan])
        times = np.array([row.milliseconds for row in group])
        scores.append(Score(
            contender, floor, len(group), len(reached) / len(group),
            float(np.mean([row.primitives for row in reached] or [np.nan])), float(ratios.mean()),
            float(np.quantile(ratios, 0.95)), float(np.median(times)), float(np.quantile(times, 0.99)),
        ))
    return scores


def write_csv(path: str | Path, rows: Sequence[QueryResult] | Sequence[Score]) -> None:
    """Write measurements or scores as CSV, one a line."""
    names = [field.name for field in dataclasses.fields(rows[0])]
    lines = [",".join(names)]
    for row in rows:
        values = (getattr(row, name) for name in names)
        lines.append(",".join(f"{value:.6g}" if isinstance(value, float) else str(value) for value in values))
    write_text(path, "\n".join(lines) + "\n")


def draw_scores(path: str | Path, rows: Sequence[QueryResult]) -> None:
    """Draw two panels with a box for each contender: ratio to the fewest primitives, and time (logarithmic)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # costs 0.3 s, and only a picture needs it
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row.contender for row in rows))[::-1]
    figure = Figure(figsize=(9.0, 0.8 + 0.34 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    reached = [[row for row in rows if row.contender == name and row.reached] for name in names]
    ratios = [[row.primitives / row.fewest for row in group] for group in reached]
    times = [[row.milliseconds for row in rows if row.contender == name] for name in names]
    look = {"orientation": "horizontal", "whis": (5, 95), "sym": ".", "patch_artist": True,
            "flierprops": {"markersize": 3, "alpha": 0.4}, "medianprops": {"color": "black"}}
    for axes, values, colour in ((left, ratios, "#8fb8de"), (right, times, "#f2c57c")):
        axes.boxplot(values, boxprops={"facecolor": colour}, **look)
        axes.grid(axis="x", alpha=0.3)
    shares = [len(group) / len(asked) for group, asked in zip(reached, times, strict=True)]
    labels = [f"{name}  {share:.0%}" for name, share in zip(names, shares, strict=True)]
    left.set_yticks(range(1, len(names) + 1), labels)
    left.set_xlabel("primitives, as a multiple of the fewest")
    right.set_xscale("log")
    right.set_xlabel("time, ms")
    left.set_title("contender and share of goals reached", fontsize=9, loc="left")
    right.set_title(f"{len(times[0])} queries; boxes: quartiles, whiskers: 5 to 95 %", fontsize=9, loc="left")
    figure.savefig(path, dpi=150)
