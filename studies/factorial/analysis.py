"""Main effects of the screening designs, their paths, the course of both recipes, and what follows from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ConfigError, UnknownNameError
from studies.factorial.design import ALGORITHMS, FACTORS, make_factorial_grid, name_factorial
from studies.factorial.effects import SIGNIFICANT, MainEffect, Screening, mark_gaps
from studies.factorial.words import (
    FEWEST_ROOMS,
    FEWEST_SEEDS,
    Findings,
    advise,
    analyse_screening,
    conclude,
    tell_first_look,
    tell_fresh_runs,
)
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.raw import BINS, RawRun, collect_runs
from studies.running import GridArgs, refuse_failures
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "analyse", "draw_effects", "measure"]

LINES = (RawRun,)
FIFTHS = 5
_COURSES = {"efficiency": ("training_efficiencies", 2), "entropy, nats": ("entropy", 2),
            "longest repeat, decisions": ("longest_repeat", 0), "greedy choices": ("greedy", 2)}
"""Quantity -> field of a run, and decimals."""
_VERDICTS = {True: "yes", False: "no", None: "not shown"}


@dataclasses.dataclass(frozen=True)
class Args(GridArgs):
    """Options of the screening."""

    algorithms: tuple[str, ...] = ("sarsa",)
    """Algorithms to run: sarsa, ddpg. The page tells of all whose results are there."""
    rooms: int = 5
    """Number of rooms, drawn from one room configuration."""
    runs: int = 5
    """Training seeds of each agent in each room; fewer than five conclude nothing."""
    primitives: int = 4_000
    """Training budget of a run."""
    first_seed: int = 0
    """Lowest training seed and lowest instance of the rooms. Above 0 the page holds the results against the published
    ones."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Run the designs of the algorithms that are asked for."""
    if not args.algorithms:
        raise ConfigError("algorithms", "", f"name one or more of {', '.join(ALGORITHMS)}")
    for name in args.algorithms:
        if name not in ALGORITHMS:
            raise UnknownNameError("algorithm of this factorial", name, ALGORITHMS)
    for name in args.algorithms:
        grid = make_factorial_grid(name, args.rooms, args.runs, args.primitives, args.first_seed)
        comparison = run_grid(grid, args.out / grid.name, LocalLauncher(args.workers))
        refuse_failures(comparison)
        store.add(collect_runs(comparison))


def analyse(study: Study, lines: Sequence[RawRun]) -> Page:
    """Findings by algorithm, tables and figures.

    Raises:
        ComparisonError: a run of a design is missing.
    """
    published, again = ({name: Screening.make(name, runs) for name in ALGORITHMS
                         if (runs := [run for run in lines if run.grid == name_factorial(name, is_fresh)])}
                        for is_fresh in (False, True))
    found = {name: analyse_screening(screening) for name, screening in published.items()}
    said = {name: conclude(findings) for name, findings in found.items()}
    conclusions = {name: " ".join(sentences) for name, sentences in said.items()}
    looks = {name: tell_first_look(findings, study.data["first_look"].get(name)) for name, findings in found.items()}
    return Page({
        "SIGNIFICANT": SIGNIFICANT, "FEWEST_SEEDS": FEWEST_SEEDS, "FEWEST_ROOMS": FEWEST_ROOMS, "FACTORS": FACTORS,
        "advice": advise(*next((findings, FACTORS[name]) for name, findings in found.items())),
        "conclusions": conclusions, "said": said, "first_looks": [look for look in looks.values() if look],
        "again": {name: (screening, tell_fresh_runs(screening, found[name])) for name, screening in again.items()
                  if name in found},
        "found": {name: {
            "screening": findings.screening, "effects": _tabulate_effects(findings), "paths": _list_paths(findings),
            "sufficient": {factor: _VERDICTS[verdict] for factor, verdict in findings.sufficient.items()},
            "course": _tabulate_course(findings.screening),
        } for name, findings in found.items()},
        "missing": [name for name in FACTORS if name not in found],
    }, {f"why-{name}": draw_effects(findings.effects, findings.levels) for name, findings in found.items()},
        [f"{name}: {told}" for name, told in conclusions.items()])


def _tabulate_effects(findings: Findings) -> str:
    rows = [[effect.factor, _tell_interval(effect), "< 0.001" if effect.p < 0.001 else f"{effect.p:.3f}",
             *(f"{value:+.2f}" for value in effect.rooms), _tell_interval(level)]
            for effect, level in zip(findings.effects, findings.levels, strict=True)]
    return make_table(["factor", "on the slope", "p", *findings.screening.rooms, "on the level"], rows)


def _tell_interval(effect: MainEffect) -> str:
    test = effect.test
    return f"{test.difference:+.3f} ({test.low:+.3f} to {test.high:+.3f})"


def _list_paths(findings: Findings) -> list[list[str]]:
    return [[path.factor, path.mediator, f"{path.moves:+.3f}", f"{path.slope:+.3f}",
             f"{path.carries:+.3f} ({path.low:+.3f} to {path.high:+.3f})"] for path in findings.paths]


def _tabulate_course(screening: Screening) -> str:
    """Training of the two recipes, fifth by fifth."""
    rows: list[list[Any]] = []
    for title, (key, digits) in _COURSES.items():
        for recipe, row in (("published", 0), ("corrected", -1)):
            values = np.array([mark_gaps(getattr(block[row], key)) for block in screening.runs.values()])
            fifths = values.reshape(len(values), FIFTHS, BINS // FIFTHS)
            means = [_average(fifths[:, number].ravel()) for number in range(FIFTHS)]
            rows.append([title, recipe, *(f"{mean:.{digits}f}" for mean in means)])
    return make_table(["quantity", "recipe", *(f"fifth {number + 1}" for number in range(FIFTHS))], rows)


def _average(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def draw_effects(effects: Sequence[MainEffect], levels: Sequence[MainEffect]) -> Figure:
    """Main effects on slope and level with their intervals over rooms, corrected; a dot a room."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.6, 3.2), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        at = np.arange(len(effects))[::-1]
        for axes, own, title in zip(panels, (effects, levels), ("slope", "level"), strict=True):
            middle = [effect.test.difference for effect in own]
            reach = np.array([[effect.test.difference - effect.test.low, effect.test.high - effect.test.difference]
                              for effect in own]).T
            for shown, colour in ((True, palette.LINES[0]), (False, palette.MUTED)):
                chosen = [n for n, effect in enumerate(own) if effect.is_shown == shown]
                axes.errorbar([middle[n] for n in chosen], at[chosen], xerr=reach[:, chosen], fmt="o", markersize=5,
                              color=colour, ecolor=colour, capsize=2, label="shown" if shown else "not shown")
            for number, (place, effect) in enumerate(zip(at, own, strict=True)):
                axes.plot(effect.rooms, [place - 0.25] * len(effect.rooms), ".", markersize=4, color=palette.LINES[4],
                          label=None if number else "a room")
            axes.axvline(0, color=palette.MUTED, linewidth=0.8)
            axes.set_yticks(at, [effect.factor for effect in effects])
            axes.set_xlabel(f"effect on the {title}", color=palette.INK)
            finish_axes(axes)
            axes.xaxis.set_major_formatter("{x:+.1f}")
            axes.grid(visible=False, axis="y")
        panels[1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
