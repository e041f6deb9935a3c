"""All planners on the same queries: number of primitives against a near-exact reference, and time.

The idea is OMPL's Planner Arena (Moll, Sucan and Kavraki 2015). Queries are drawn without any
planner's help: from certified free places of generated rooms to the rooms' own goals, or to other
free places. Measured are the search along cost-to-go fields, the corridor search round each path
planner's path, and `auto`, which chooses between the two. A path planner's bare path is measured as well, for a base
that needs no primitives. Each query is timed three times: in a room
that nobody has asked anything yet, in a room that knows another goal, and with its own goal known.
"""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.reference_search import find_fewest_primitives
from hrl_escape.env.config import ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.certificate import FreeSpace
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GenerationError
from hrl_escape.files import write_text
from hrl_escape.kernels import read_clock
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import ExitGoal, Goal, PoseGoal, PressGoal, is_reached, name_goal
from hrl_escape.planning.motion.limits import MotionLimits, compute_duration, compute_rest_to_rest
from hrl_escape.planning.paths.navigator import PathResult
from hrl_escape.planning.paths.planners import list_planners
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER
from hrl_escape.planning.search.primitive_search import METHODS, PrimitiveSearch, SearchResult

__all__ = ["AUTO", "FIELDS", "FLOORS", "PATH", "Floor", "Query", "QueryResult", "Score", "draw_scores",
           "list_contenders", "make_queries", "measure", "score_contenders", "write_csv"]

AUTO = "auto"
"""Name of the contender that chooses between fields and a corridor, as planners do by default."""
FIELDS = "fields"
"""Name of the contender that needs no path planner."""
PATH = "-path"
"""End of the name of a contender that is a path planner alone, as in `RRTConnect-path`."""
LIMITS = MotionLimits()
"""Limits for times of motion."""


@dataclasses.dataclass(frozen=True)
class Floor:
    """A kind of queries.

    Attributes:
        config: configuration of the rooms.
        goals: goals asked for: the room's buttons and exit in turn, or free places.
        has_reference: the near-exact reference answers within seconds.
    """

    config: RoomConfig
    goals: Literal["targets", "places"] = "targets"
    has_reference: bool = True


def _make_config(obstacles: int, rooms: int, largest: float = 2.0, doorway: float = 2.4, side: float = 20.0
                 ) -> RoomConfig:
    return RoomConfig(
        room=ShapeConfig(width=side, depth=side, rooms=rooms, doorway_width=doorway),
        robot=RobotConfig(body_radius=0.5), puzzle=ButtonsConfig(count=3, buttons=Panels(width=1.5)),
        obstacles=ObstaclesConfig(count=obstacles, size_max=largest),
    )


_WIDE = {side: _make_config(60, 9, 4.0, 3.0, side) for side in (60.0, 200.0)}

FLOORS = {
    "empty": Floor(_make_config(0, 1)),
    "10 obstacles": Floor(_make_config(10, 1)),
    "40 obstacles": Floor(_make_config(40, 1, 1.5)),
    "interior walls": Floor(_make_config(15, 3)),
    "narrow passages": Floor(_make_config(20, 6, 1.5, 1.6)),
    "60 m": Floor(_WIDE[60.0], has_reference=False),
    "200 m": Floor(_WIDE[200.0], has_reference=False),
    "places, 10 obstacles": Floor(_make_config(10, 1), "places"),
    "places, interior walls": Floor(_make_config(15, 3), "places"),
    "places, 60 m": Floor(_WIDE[60.0], "places", has_reference=False),
    "places, 200 m": Floor(_WIDE[200.0], "places", has_reference=False),
}
"""Kinds of queries to compare planners on, on floors of 20 x 20 m unless the name says otherwise."""


@dataclasses.dataclass(frozen=True)
class Query:
    """One query and the reference's answer.

    Attributes:
        floor: name of the room configuration.
        search: primitive search of the room.
        state: first state.
        goal: the goal.
        other: another goal of the room.
        fewest: number of primitives that the near-exact reference needs; 0 without a reference.
    """

    floor: str
    search: PrimitiveSearch
    state: RoomState
    goal: Goal
    other: Goal
    fewest: int


@dataclasses.dataclass(frozen=True)
class QueryResult:
    """Result of one contender on one query.

    Attributes:
        contender: `AUTO`, `FIELDS`, a path planner, or its bare path.
        floor: name of the room configuration.
        instance: id of the room.
        goal: the goal in words.
        reached: the goal was reached, confirmed by replay, without falling back on another contender.
        primitives: number of primitives; 0 for a bare path.
        fewest: number of primitives of the reference, or of the best contender where there is none.
        cold_ms: time of the first query that the room is asked, with all that it prepares.
        new_ms: time in a room that has been asked for another goal before.
        milliseconds: time in a room that has been asked for this goal before.
        metres: way of the base.
        seconds: time of the motion under `LIMITS`, at rest wherever its direction changes.
    """

    contender: str
    floor: str
    instance: str
    goal: str
    reached: bool
    primitives: int
    fewest: int
    cold_ms: float
    new_ms: float
    milliseconds: float
    metres: float
    seconds: float


@dataclasses.dataclass(frozen=True)
class Score:
    """Summary of a contender on one kind of queries.

    Ratios are to the fewest primitives. They, and the means of primitives, metres and seconds, are over the goals
    that it reached.
    """

    contender: str
    floor: str
    queries: int
    success: float
    primitives: float
    ratio: float
    ratio_p95: float
    metres: float
    seconds: float
    cold_ms: float
    new_ms: float
    median_ms: float
    p99_ms: float


def list_contenders() -> tuple[str, ...]:
    """All contenders: `AUTO`, `FIELDS`, every path planner, and the bare path of each."""
    return (AUTO, FIELDS, *list_planners(), *(name + PATH for name in list_planners()))


def make_queries(floor: str, seeds: Iterable[int], each: int, config: RoomConfig | None = None) -> list[Query]:
    """Draw queries and answer them with the reference.

    Args:
        floor: one of `FLOORS`, or any name if `config` is given.
        seeds: instance seeds, one room each; seeds without a room are left out.
        each: number of queries in a room; their goals cycle through its buttons and exit, or are free places.
        config: another room configuration; its buttons are pressed by the body and its exit has no door.
    """
    kind = Floor(config) if config else FLOORS[floor]
    queries: list[Query] = []
    for seed in seeds:
        try:
            instance = generate(kind.config, seed)
        except GenerationError:
            continue  # a floor of 200 m can take more work than a certificate is given
        search = PrimitiveSearch(instance)
        rules, rng = search.kinematics, np.random.default_rng([seed, 3])
        space = FreeSpace(instance.reach_x, instance.reach_y, instance.robot.body_radius, instance.solids)
        begin = rules.make_state(instance.starts[0])
        cells = space.get_cells(space.find_label(begin.x, begin.y))
        goals: list[Goal] = [*(PressGoal(i) for i in range(len(instance.targets))), ExitGoal()]
        if kind.goals == "places":
            goals = [PoseGoal(*place) for place in space.grid.get_centres(rng.choice(cells, each + 1)).tolist()]
        for number in range(each):
            goal, other = goals[number % len(goals)], goals[(number + 1) % len(goals)]
            state = _draw_state(rules, space, cells, begin, goal, rng)
            found: tuple[int, ...] | None = ()
            if kind.has_reference:
                found = find_fewest_primitives(rules, state, goal, *compute_goal_area(goal, instance))
            if found is not None:
                queries.append(Query(floor, search, state, goal, other, len(found)))
    return queries


def _draw_state(rules: Kinematics, space: FreeSpace, cells: np.ndarray, begin: RoomState, goal: Goal,
                rng: np.random.Generator) -> RoomState:
    """Draw a free place and a heading that does not reach the goal yet."""
    while True:
        x, y = space.grid.get_centres(cells[rng.integers(len(cells))]).tolist()
        heading = int(rng.integers(rules.headings))
        touching = rules.compute_touching(x, y, heading, 0.0, begin.joint_steps, ())
        state = begin._replace(x=x, y=y, heading_steps=heading, touching=touching)
        if not touching and not is_reached(goal, state, state, rules):
            return state


def measure(queries: Sequence[Query], contenders: Sequence[str],
            report: Callable[[str], None] = lambda _: None) -> list[QueryResult]:
    """Run every contender on every query.

    Args:
        queries: from `make_queries`.
        contenders: some of `list_contenders()`.
        report: called with each contender's name before its turn at a query.
    """
    rows: list[QueryResult] = []
    for query in queries:
        answers: list[QueryResult] = []
        for contender in contenders:
            report(contender)
            answers.append(_measure_query(query, contender))
        best = min((answer.primitives for answer in answers if answer.reached and answer.primitives), default=0)
        rows += [dataclasses.replace(answer, fewest=query.fewest or best) for answer in answers]
    return rows


def _measure_query(query: Query, contender: str) -> QueryResult:
    """Ask a contender in a new room, again, and in another new room after another goal."""
    instance = query.search.instance
    method, planner = (contender, DEFAULT_PLANNER) if contender in METHODS else ("corridor", contender)

    def ask(search: PrimitiveSearch, goal: Goal) -> tuple[SearchResult | PathResult, float]:
        began = read_clock()
        if contender.endswith(PATH):
            result = search.navigator.plan((query.state.x, query.state.y), goal, contender.removesuffix(PATH))
        else:
            result = search.search(query.state, goal, method=method, planner=planner)
        return result, 1e3 * (read_clock() - began)

    one, other = (PrimitiveSearch(instance, query.search.kinematics) for _ in range(2))
    result, cold = ask(one, query.goal)
    _, again = ask(one, query.goal)
    ask(other, query.other)
    _, new = ask(other, query.goal)
    goal = name_goal(query.goal, instance)
    if isinstance(result, PathResult):
        lines = np.hypot(*np.diff(result.path, axis=0).T).tolist()
        seconds = sum(compute_rest_to_rest(line, LIMITS.speed, LIMITS.acceleration, LIMITS.jerk) for line in lines)
        return QueryResult(contender, query.floor, instance.id, goal, result.status == "exact", 0, 0, cold, new, again,
                           sum(lines), seconds)
    is_own = contender == AUTO or result.method == contender
    places = np.array([(state.x, state.y) for state in result.states])
    seconds = compute_duration(result.states, LIMITS, query.search.kinematics.robot, query.search.kinematics.turn_step)
    return QueryResult(contender, query.floor, instance.id, goal, result.is_reached and is_own, len(result.primitives),
                       0, cold, new, again, float(np.hypot(*np.diff(places, axis=0).T).sum()), seconds)


def score_contenders(rows: Sequence[QueryResult]) -> list[Score]:
    """One score for each contender and floor, in the order of the measurements."""
    groups: dict[tuple[str, str], list[QueryResult]] = {}
    for row in rows:
        groups.setdefault((row.floor, row.contender), []).append(row)
    scores = []
    for (floor, contender), group in groups.items():
        reached = [row for row in group if row.reached]
        ratios = np.array([row.primitives / row.fewest for row in reached if row.primitives] or [np.nan])
        metres, seconds = np.mean([(row.metres, row.seconds) for row in reached] or [(np.nan, np.nan)], axis=0).tolist()
        times = np.array([(row.cold_ms, row.new_ms, row.milliseconds) for row in group])
        cold, new, again = np.median(times, axis=0).tolist()
        scores.append(Score(
            contender, floor, len(group), len(reached) / len(group),
            float(np.mean([row.primitives for row in reached if row.primitives] or [np.nan])), float(ratios.mean()),
            float(np.quantile(ratios, 0.95)), metres, seconds, cold, new, again, float(np.quantile(times[:, 2], 0.99)),
        ))
    return scores


def write_csv(path: str | Path, rows: Sequence[QueryResult] | Sequence[Score]) -> None:
    """Write measurements or scores as CSV, one a line."""
    names = [field.name for field in dataclasses.fields(rows[0])]
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(names)
    for row in rows:
        values = (getattr(row, name) for name in names)
        lines.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in values)
    write_text(path, text.getvalue())


def draw_scores(path: str | Path, rows: Sequence[QueryResult]) -> None:
    """Draw two panels with a box for each contender: ratio to the fewest primitives, and time (logarithmic)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # costs 0.3 s, and only a picture needs it
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row.contender for row in rows))[::-1]
    figure = Figure(figsize=(9.0, 0.8 + 0.34 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    reached = [[row for row in rows if row.contender == name and row.reached] for name in names]
    ratios = [[row.primitives / row.fewest for row in group if row.primitives] for group in reached]
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
