"""Parts of a hierarchy: registered runs, registered answers, and what the runs show by number of buttons."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from hrl_escape.agents.old_specs import convert_label
from hrl_escape.agents.spec import ORACLE, AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.sets.instance_set import InstanceSet
from studies.buttons.analysis import FirstEscape, find_first_escape
from studies.parts.answers import Answer, Law, PartsRun, answer, find_exchange, fit_law, is_given_up
from studies.parts.reach import count_escapes, draw_medians, draw_reach, find_medians
from studies.parts.runs import Cell, LearnerSettings, play_cell
from studies.running import StudyArgs
from studies.statistics import compute_restricted_mean
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "REGISTERED", "Args", "SizeRatio", "analyse", "compare_sizes", "compute_design",
           "format_ratio", "list_jobs", "list_missing", "make_config", "measure", "run_job"]

LINES = (PartsRun,)
REGISTERED = ("study.toml", "questions.md")


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command resumes."""
    confirmation: bool = False
    """Run the fresh rooms and seeds, in place of the first ones."""
    cells: tuple[str, ...] = ()
    """Cells to run; all by default."""


def compute_design(study: Study) -> str:
    """Hash of the registered files, 16 hexadecimal digits."""
    content = b"".join((study.folder / name).read_bytes() for name in REGISTERED)
    return hashlib.sha256(content).hexdigest()[:16]


# --- runs ------------------------------------------------------------------------------------


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, from small rooms to large; cells that are given up are left out.

    Raises:
        ComparisonError: the results are of another design.
        UnknownNameError: no such cell.
    """
    data, design = study.data, compute_design(study)
    known = {cell["name"] for cell in data["cells"]}
    if unknown := [name for name in args.cells if name not in known]:
        raise UnknownNameError("cell", unknown[0], known)
    slice_ = "confirmation" if args.confirmation else "first"
    runs = {run.place: run for run in _check(study, store.load())}
    console, end = Console(stderr=True, highlight=False), time.monotonic() + 60 * (args.minutes or math.inf)
    begun, seconds = len(runs), time.monotonic()
    for job in list_jobs(data, slice_, design, args.cells):
        if job.place in runs or _is_given_up(job, runs.values(), data):
            continue
        if time.monotonic() > end:
            console.print("time is up: the same command resumes")
            return
        runs[job.place] = run_job(job, data)
        store.add([runs[job.place]])
        if len(runs) % 50 == 0:
            rate = (len(runs) - begun) / (time.monotonic() - seconds)
            console.print(f"{job.buttons} buttons, {len(runs):,} runs, {rate:.1f} a second")


def _is_given_up(job: PartsRun, runs: Iterable[PartsRun], data: Mapping[str, Any]) -> bool:
    """The cell of a run was given up with so many buttons or fewer, in the same slice."""
    own = [run for run in runs if (run.cell, run.rule, run.failure) == (job.cell, job.rule, job.failure)
           and _get_slice(data, run.seed) == _get_slice(data, job.seed)]
    return is_given_up(own, job.buttons, data["hopeless"])


def list_missing(data: Mapping[str, Any], slice_: str, runs: Sequence[PartsRun]) -> list[PartsRun]:
    """Registered runs of a slice that are still to be made, as lines without results."""
    there = {run.place for run in runs}
    return [job for job in list_jobs(data, slice_, "") if job.place not in there and not _is_given_up(job, runs, data)]


def list_jobs(data: Mapping[str, Any], slice_: str, design: str, cells: Sequence[str] = ()) -> Iterator[PartsRun]:
    """Lines without their results, in the order of running: sizes, then rooms, so that a room's plans serve all cells.

    The dial comes last.
    """
    first, count = data["slices"][slice_]["first_seed"], data["slices"][slice_]["runs"]
    dial = data["dial"]
    for size in data["sizes"]:
        for seed in range(first, first + count):
            for rule in data["rules"]:
                for cell in data["cells"]:
                    if size in cell.get("sizes", data["sizes"]) and (not cells or cell["name"] in cells):
                        yield PartsRun(cell["name"], rule, size, seed, 0.0, None, None, design)
    for seed in range(first, first + count) if not cells or dial["better"] in cells else ():
        for rule in data["rules"]:
            for failure in dial["failures"]:
                yield PartsRun(dial["better"], rule, dial["buttons"], seed, failure, None, None, design)


def run_job(job: PartsRun, data: Mapping[str, Any]) -> PartsRun:
    """Make the run of a line without results."""
    cell = next(cell for cell in data["cells"] if cell["name"] == job.cell)
    config = make_config(data["room"], job.buttons, job.rule)
    if "reference" in cell:
        return dataclasses.replace(job, first_escape=_search(cell["reference"], config, job.seed, data["budget"]))
    room, near = _make_room(config, job.seed), data["near"]
    fewest = _find_fewest(room) if job.buttons in near["sizes"] and not job.failure else None
    parts = Cell(**{name: cell[name] for name in ("walks", "memory", "structure") if name in cell}, failure=job.failure)
    found = play_cell(parts, LearnerSettings(**data["learner"]), room, job.seed, data["budget"], fewest, near["budget"])
    return dataclasses.replace(job, first_escape=found.first_escape, near_best=found.near_best)


@lru_cache(maxsize=8)
def _make_room(config: RoomConfig, seed: int) -> RoomInstance:
    return generate(config, seed)


@lru_cache(maxsize=8)
def _find_fewest(room: RoomInstance) -> int | None:
    """Primitives of the best known plan."""
    return find_first_escape(ORACLE, room, 0, 1_000)


def make_config(room: Mapping[str, Any], buttons: int, rule: str) -> RoomConfig:
    """Room configuration of a square room, as large for many buttons as for few."""
    puzzle = {"count": buttons, "graph": room["graph"], "on_violation": rule, "buttons": {"width": room["button"]}}
    return RoomConfig(name=f"parts-{buttons}-{rule}", room=ShapeConfig(width=room["width"], depth=room["width"]),
                      robot=RobotConfig(body_radius=room["body"]), puzzle=ButtonsConfig.from_dict(puzzle))


def _search(reference: str, config: RoomConfig, seed: int, budget: int) -> int | None:
    """Primitives to the first escape of a reference, which may ask how the room was drawn."""
    spec = AgentSpec.parse(convert_label(reference))  # study.toml is registered with names of version 0.3
    env, recorder = make_agent_env(spec, InstanceSet(reference, config, [seed]), "features")
    try:
        return train(make_reference(spec.name, env, recorder), env, primitives=budget, seed=seed, eval_episodes=0,
                     probe=FirstEscape(), progress=False, observed=False).first_escape
    finally:
        env.close()


def _get_slice(data: Mapping[str, Any], seed: int) -> str:
    """Slice that a seed belongs to."""
    return next(name for name, own in data["slices"].items()
                if own["first_seed"] <= seed < own["first_seed"] + own["runs"])


def _check(study: Study, lines: Sequence[PartsRun]) -> Sequence[PartsRun]:
    """Refuse lines of another design.

    Raises:
        ComparisonError: there are some.
    """
    design = compute_design(study)
    if other := [line for line in lines if line.design != design]:
        raise ComparisonError(f"{len(other)} lines are of the design {other[0].design}, and {' and '.join(REGISTERED)} "
                              f"now give {design}: a new design begins with results of its own (--docs)")
    return lines


# --- findings --------------------------------------------------------------------------------


class SizeRatio(NamedTuple):
    """Primitives to the first escape without a part over those with it, in rooms of one size.

    Attributes:
        median: over the rooms where one of the two escaped; infinite if without it most runs do not.
        rooms: these rooms.
        made: rooms where both were run.
    """

    median: float
    rooms: int
    made: int


def compare_sizes(runs: Sequence[PartsRun], more: str, less: str, rule: str) -> dict[int, SizeRatio]:
    """Compare two cells room by room, for each number of buttons where both were run.

    A run that did not escape within the budget took longer than one that did; a run that was not made counts nowhere.
    """
    ends: dict[tuple[int, int], dict[str, float]] = defaultdict(dict)
    for run in runs:
        if (run.rule, run.failure) == (rule, 0.0):
            ends[run.buttons, run.seed][run.cell] = run.first_escape or math.inf
    found = {}
    for size in sorted({buttons for buttons, _ in ends}):
        pairs = [(own[less], own[more]) for (buttons, _), own in ends.items() if buttons == size
                 and more in own and less in own]
        ratios = [without / with_it if without < math.inf else math.inf for without, with_it in pairs
                  if min(without, with_it) < math.inf]
        if pairs:
            found[size] = SizeRatio(float(np.median(ratios)) if ratios else math.nan, len(ratios), len(pairs))
    return found


def summarise(runs: Sequence[PartsRun], data: Mapping[str, Any]) -> SimpleNamespace:
    """Numbers of one slice: registered answers, and counts, medians and ratios by number of buttons."""
    answers = answer(runs, data)
    cells = [(cell["name"], rule) for cell in data["cells"] for rule in data["rules"]]
    return SimpleNamespace(
        answers={(one.more, one.less, one.rule): one for one in answers},
        ratios={(one.more, one.less, one.rule): compare_sizes(runs, one.more, one.less, one.rule) for one in answers},
        escapes={(name, rule): count_escapes(runs, name, rule) for name, rule in cells},
        medians={(name, rule): find_medians(runs, name, rule) for name, rule in cells},
    )


def analyse(study: Study, lines: Sequence[PartsRun]) -> Findings:
    """Registered answers of the first and of the fresh rooms, and what both show by number of buttons.

    Raises:
        ComparisonError: runs are missing, or some are of another design.
    """
    data = study.data
    slices = {name: [line for line in _check(study, lines) if _get_slice(data, line.seed) == name]
              for name in data["slices"]}
    if missing := {name: count for name, own in slices.items() if (count := len(list_missing(data, name, own)))}:
        raise ComparisonError(f"registered runs are still to be made: {missing}")
    first, fresh = (summarise(slices[name], data) for name in ("first", "confirmation"))
    agree = sum(one.verdict == other.verdict for one, other in zip(first.answers.values(), fresh.answers.values(),
                                                                   strict=True))
    laws = {(cell["name"], rule): fit_law([run for run in slices["first"] if (run.cell, run.rule, run.failure)
                                           == (cell["name"], rule, 0)])
            for cell in data["cells"] for rule in data["rules"]}
    exchanges = {rule: find_exchange(slices["first"], data, rule) for rule in data["rules"]}
    sizes = list(map(str, data["sizes"]))
    near = [(rule, size) for rule in data["rules"] for size in data["near"]["sizes"]]
    return Findings(
        SimpleNamespace(first=first, fresh=fresh, agree=agree, design=compute_design(study), exchanges=exchanges,
                        data=data),
        {"ratios": make_table(["with", "without", "rule", *sizes],
                              [_list_ratios(key, own, data) for key, own in first.ratios.items()]),
         "answers": make_table(["with", "without", "rule", "times fewer primitives", "change of the exponent",
                                "p, Holm", "rooms", "fresh rooms"],
                               [_list_answer(one, other) for one, other in
                                zip(first.answers.values(), fresh.answers.values(), strict=True)]),
         "laws": make_table(["cell", *(f"`{rule}`" for rule in data["rules"])], [
             [_name(cell["name"]), *(_format_law(laws[cell["name"], rule]) for rule in data["rules"])]
             for cell in data["cells"]]),
         **{f"medians_{rule}": make_table(["cell", *sizes], [
             [_name(cell["name"]), *(_format_cell(slices["first"], cell["name"], rule, size, data)
                                     for size in data["sizes"])]
             for cell in data["cells"]]) for rule in data["rules"]},
         "near": make_table(["cell", *(f"{size}, `{rule}`" for rule, size in near)], [
             [cell["name"], *(_format_near(slices["first"], cell["name"], rule, size, data) for rule, size in near)]
             for cell in data["cells"] if "reference" not in cell])},
        {"parts": lambda theme: draw_medians(first.medians, theme),
         "reach": lambda theme: draw_reach(lines, theme)})


def _name(cell: str) -> str:
    """Display name of a cell; `study.toml` is registered with names of version 0.3."""
    return {"untried-nearest": "search, nearest first", "retrace": "search with backtracking",
            "ceiling": "Bayes planner"}.get(cell, cell)


def _list_ratios(key: tuple[str, str, str], ratios: Mapping[int, SizeRatio], data: Mapping[str, Any]) -> list[str]:
    more, less, rule = key
    return [_name(more), _name(less), f"`{rule}`",
            *(_format_size(ratios[size]) if size in ratios else "" for size in data["sizes"])]


def _format_size(ratio: SizeRatio) -> str:
    if not ratio.rooms:
        return "neither"
    return ("only with" if math.isinf(ratio.median) else "only without" if not ratio.median else
            format_ratio(ratio.median))


def format_ratio(value: float) -> str:
    """A ratio with three digits, at most two of them decimals."""
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}"


def _list_answer(one: Answer, other: Answer) -> list[str]:
    return [_name(one.more), _name(one.less), f"`{one.rule}`", _format_factor(one), _format_slope(one),
            "< 0.001" if one.p < 0.001 else f"{one.p:.3f}", str(one.rooms), _format_factor(other)]


def _format_factor(one: Answer) -> str:
    words = f"{format_ratio(one.factor)} ({format_ratio(one.low)} to {format_ratio(one.high)})"
    return words if one.verdict == "open" else f"**{words}**"


def _format_slope(one: Answer) -> str:
    if one.slope is None:
        return ""
    middle, low, high = (-value for value in one.slope)
    return f"{middle:+.1f} ({high:+.1f} to {low:+.1f})"


def _format_law(law: Law | None) -> str:
    if law is None:
        return ""
    return f"{law.constant:.2g} × n^{law.exponent:.1f} ({law.low:.1f} to {law.high:.1f}); {law.shape}"


def _format_cell(runs: Sequence[PartsRun], name: str, rule: str, size: int, data: Mapping[str, Any]) -> str:
    own = [run for run in runs if (run.cell, run.rule, run.buttons, run.failure) == (name, rule, size, 0)]
    if not own:
        return ""
    ends = np.array([run.first_escape or data["budget"] for run in own])
    escaped = np.array([run.first_escape is not None for run in own])
    middle = float(np.median(np.where(escaped, ends, np.inf)))
    return (f"{escaped.sum()} of {len(own)}; {'never' if math.isinf(middle) else f'{middle:,.0f}'}; "
            f"{compute_restricted_mean(ends, escaped, data['budget']):,.0f}")


def _format_near(runs: Sequence[PartsRun], name: str, rule: str, size: int, data: Mapping[str, Any]) -> str:
    own = [run.near_best for run in runs if (run.cell, run.rule, run.buttons, run.failure) == (name, rule, size, 0)]
    limit, came = data["near"]["budget"], np.array([end is not None for end in own])
    ends = np.array([limit if end is None else end for end in own])
    return f"{came.sum()} of {len(own)}; {compute_restricted_mean(ends, came, limit):,.0f}"
