"""Parts of a hierarchy: registered runs, answers by rule, and a page with its abstract of eight sentences."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from rich.console import Console
from studies.price.words import tell_number

from hrl_escape.agents.old_specs import convert_label
from hrl_escape.agents.spec import ORACLE, AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.sets.instance_set import InstanceSet
from studies.buttons.analysis import FirstEscape, find_first_escape
from studies.page import make_table
from studies.parts.answers import (
    Answer,
    Law,
    PartsRun,
    answer,
    find_exchange,
    fit_law,
    is_given_up,
    tell_abstract,
    tell_again,
    tell_bar,
    tell_finding,
    tell_law,
    tell_ratio,
)
from studies.parts.figure import draw
from studies.parts.reach import draw_reach
from studies.parts.runs import Cell, LearnerSettings, play_cell
from studies.running import StudyArgs
from studies.statistics import compute_restricted_mean
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "REGISTERED", "Args", "analyse", "compute_design", "list_jobs", "list_missing", "make_config",
           "make_latex", "measure", "run_job"]

LINES = (PartsRun,)
REGISTERED = ("study.toml", "questions.md")


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command goes on."""
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
            console.print("time is up: the same command goes on")
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
    """Make the run that a line without results stands for."""
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


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[PartsRun]) -> Page:
    """Abstract, figure and tables of the first runs, and the abstract of the confirmation once all of it is there.

    Raises:
        ComparisonError: there are no runs, or some of another design.
    """
    data = study.data
    slices = {name: [line for line in _check(study, lines) if _get_slice(data, line.seed) == name]
              for name in data["slices"]}
    if not slices["first"]:
        raise ComparisonError("there are no runs to tell of")
    missing = {name: len(list_missing(data, name, own)) for name, own in slices.items()}
    again, _, confirmed = ([], {}, []) if missing["confirmation"] else _conclude(slices["confirmation"], data)
    answers, laws, abstract = _conclude(slices["first"], data, again)
    bar = tell_bar(answers, slices["first"])
    rows = _list_rows(answers, again)
    return Page({
        "missing": missing, "finding": f"{tell_finding(answers)} {bar}",
        "abstract": abstract, "confirmed": confirmed,
        "agree": tell_again(answers, again) if again else "",
        "answers": make_table(HEADER, rows), "count": len(answers), "design": compute_design(study),
        "growth": make_table(["cell", *(f"`{rule}`" for rule in data["rules"])], [
            [cell["name"], *(_describe_law(laws[cell["name"], rule]) for rule in data["rules"])]
            for cell in data["cells"]]),
        "medians": [(rule, make_table(["cell", *map(str, data["sizes"])], [
            [cell["name"], *(_describe(slices["first"], cell, rule, size, data) for size in data["sizes"])]
            for cell in data["cells"]])) for rule in data["rules"]],
        "near": make_table(["cell", *(f"{size}, `{rule}`" for rule in data["rules"] for size in data["near"]["sizes"])],
                           [[cell["name"], *(_describe_near(slices["first"], cell["name"], rule, size, data)
                                             for rule in data["rules"] for size in data["near"]["sizes"])]
                            for cell in data["cells"] if "reference" not in cell]),
        "told": make_table(["cell", "what it is told"], [[cell["name"], cell["told"]] for cell in data["cells"]]),
        "power": make_table(["question", "rooms expected", "spread", "factor seen in 80 %"], [
            [f"{one['more']} against {one['less']}", one["rooms"], one["spread"], f"{one['power']:.2f}"]
            for one in data["questions"]]),
    }, {"parts": (figure := draw(slices["first"], laws, answers, data)), "parts.pdf": figure, **draw_reach(lines)},
        [tell_finding(answers), bar, *abstract],
        {"parts.tex": make_latex(HEADER[:5], [row[:5] for row in rows])})


HEADER = ["part", "with it", "without it", "rule", "times fewer primitives", "changes the exponent by", "p, Holm",
          "rooms", "80 % would see", "fresh rooms"]


def _conclude(runs: Sequence[PartsRun], data: Mapping[str, Any], again: Sequence[Answer] = ()
              ) -> tuple[list[Answer], dict[tuple[str, str], Law | None], list[str]]:
    answers = answer(runs, data)
    laws = {(name, rule): fit_law([run for run in runs if (run.cell, run.rule, run.failure) == (name, rule, 0)])
            for name in (cell["name"] for cell in data["cells"]) for rule in data["rules"]}
    exchanges = [find_exchange(runs, data, rule) for rule in data["rules"]]
    return answers, laws, tell_abstract(answers, laws, exchanges, runs, data, again)


def _list_rows(answers: Sequence[Answer], again: Sequence[Answer]) -> list[list[str]]:
    fresh = dict(enumerate(again))
    return [[one.part, one.more, one.less, f"`{one.rule}`", _describe_factor(one), _describe_slope(one),
             "-" if math.isnan(one.factor) else "< 0.001" if one.p < 0.001 else f"{one.p:.3f}", str(one.rooms),
             "-" if math.isinf(one.visible) else f"{one.visible:.2f}",
             _describe_factor(fresh[index]) if index in fresh else "-"] for index, one in enumerate(answers)]


def _describe_factor(one: Answer) -> str:
    if math.isnan(one.factor):
        return "-"
    words = f"{tell_ratio(one.factor)} ({tell_ratio(one.low)} to {tell_ratio(one.high)})"
    return words if one.verdict == "open" else f"**{words}**"


def _describe_slope(one: Answer) -> str:
    if one.slope is None:
        return "-"
    middle, low, high = (-value for value in one.slope)
    return f"{middle:+.1f} ({high:+.1f} to {low:+.1f})"


def _describe_law(law: Law | None) -> str:
    if law is None:
        return "-"
    return (f"{tell_number(law.constant)} ({tell_number(law.constant_low)} to {tell_number(law.constant_high)}) × "
            f"n^{law.exponent:.1f} ({law.low:.1f} to {law.high:.1f}); {tell_law(law)}")


def _describe(runs: Sequence[PartsRun], cell: Mapping[str, Any], rule: str, size: int, data: Mapping[str, Any]) -> str:
    own = [run for run in runs if (run.cell, run.rule, run.buttons, run.failure) == (cell["name"], rule, size, 0)]
    if not own:
        return "—"
    ends = np.array([run.first_escape or data["budget"] for run in own])
    escaped = np.array([run.first_escape is not None for run in own])
    middle = float(np.median(np.where(escaped, ends, np.inf)))
    return (f"{escaped.sum()} of {len(own)}; {'never' if math.isinf(middle) else f'{middle:,.0f}'}; "
            f"{compute_restricted_mean(ends, escaped, data['budget']):,.0f}")


def _describe_near(runs: Sequence[PartsRun], name: str, rule: str, size: int, data: Mapping[str, Any]) -> str:
    own = [run.near_best for run in runs if (run.cell, run.rule, run.buttons, run.failure) == (name, rule, size, 0)]
    if not own:
        return "—"
    limit, came = data["near"]["budget"], np.array([end is not None for end in own])
    ends = np.array([limit if end is None else end for end in own])
    return f"{came.sum()} of {len(own)}; {compute_restricted_mean(ends, came, limit):,.0f}"


def make_latex(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in LaTeX, for `booktabs`."""
    body = [" & ".join(cell.replace("**", "").replace("`", "").replace("&", r"\&").replace("%", r"\%") for cell in row)
            + r" \\" for row in (header, *rows)]
    return "\n".join([rf"\begin{{tabular}}{{{'l' * len(header)}}}", r"\toprule", body[0], r"\midrule", *body[1:],
                      r"\bottomrule", r"\end{tabular}", ""])
