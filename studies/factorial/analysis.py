"""Main effects of the screening designs: what makes SARSA and DDPG get worse with options, and fresh runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.errors import ComparisonError, ConfigError, UnknownNameError
from studies.factorial.design import ALGORITHMS, FACTORS, make_factorial_grid, name_factorial
from studies.factorial.effects import (
    MainEffect,
    Screening,
    compute_effects,
    mark_gaps,
    measure_area,
    measure_change,
    repeat_effects,
)
from studies.figures import Theme, make_figure
from studies.raw import BINS, RawRun, collect_runs
from studies.running import GridArgs, refuse_failures
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "analyse", "measure"]

LINES = (RawRun,)
FIFTHS = 5
_COURSES = {"efficiency": ("training_efficiencies", 2), "entropy of the policy, nats": ("entropy", 2),
            "longest repeat, decisions": ("longest_repeat", 0)}
"""Quantity -> field of a run, and decimals."""


@dataclasses.dataclass(frozen=True)
class Args(GridArgs):
    """Options of the screening."""

    algorithms: tuple[str, ...] = ("sarsa",)
    """Algorithms to run: sarsa, ddpg."""
    rooms: int = 5
    """Number of rooms, drawn from one room configuration."""
    runs: int = 5
    """Training seeds of each agent in each room."""
    primitives: int = 4_000
    """Training budget of a run."""
    first_seed: int = 0
    """Lowest training seed and lowest instance of the rooms; above 0 the runs are fresh ones."""


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


def analyse(study: Study, lines: Sequence[RawRun]) -> Findings:
    """Effects of the factors on the slope and the level of training, by algorithm, and of those shown in fresh runs.

    Raises:
        ComparisonError: a run of a design is missing.
    """
    screenings = {name: Screening.make(name, own) for name in ALGORITHMS
                  if (own := [run for run in lines if run.grid == name_factorial(name)])}
    fresh = {name: Screening.make(name, own) for name in ALGORITHMS
             if (own := [run for run in lines if run.grid == name_factorial(name, is_fresh=True)])}
    if missing := set(ALGORITHMS) - screenings.keys():
        raise ComparisonError(f"there is no run of {', '.join(sorted(missing))}")
    slopes = {name: compute_effects(screening, measure_change) for name, screening in screenings.items()}
    levels = {name: compute_effects(screening, measure_area) for name, screening in screenings.items()}
    again = {name: repeat_effects(screening, [effect.factor for effect in slopes[name] if effect.is_shown])
             for name, screening in fresh.items()}
    first = study.data["first_look"]["sarsa"]
    looked = compute_effects(dataclasses.replace(screenings["sarsa"], rooms=screenings["sarsa"].rooms[:first]),
                             measure_change)
    shown = {effect.factor for effect in slopes["sarsa"] if effect.is_shown}
    return Findings(
        SimpleNamespace(slopes={name: {effect.factor: effect for effect in own} for name, own in slopes.items()},
                        again={name: {effect.factor: effect for effect in own} for name, own in again.items()},
                        course=average_course(screenings["sarsa"]), first=first,
                        first_p=[effect.p for effect in looked if effect.factor in shown],
                        rooms={name: len(own.rooms) for name, own in screenings.items()}),
        {**{f"effects_{name}": make_table(["factor", "on the slope", "p", "on the level"], [
            [effect.factor, _format(effect), "< 0.001" if effect.p < 0.001 else f"{effect.p:.3f}", _format(level)]
            for effect, level in zip(slopes[name], levels[name], strict=True)]) for name in slopes},
         **{f"factors_{name}": make_table(["factor", "2019 settings", "default settings"], [
             [factor.name, factor.paper, factor.corrected] for factor in FACTORS[name]]) for name in slopes},
         "fresh": make_table(["factor", "in fresh rooms, on the slope", "p"], [
             [effect.factor, _format(effect), f"{effect.p:.3f}"] for own in again.values() for effect in own]),
         "course": make_table(["quantity", "settings", *(f"fifth {number + 1}" for number in range(FIFTHS))], [
             [title, recipe, *(f"{value:.{_COURSES[title][1]}f}" for value in values)]
             for (title, recipe), values in average_course(screenings["sarsa"]).items()])},
        {"why-sarsa": lambda theme: draw_effects(slopes["sarsa"], theme)})


def _format(effect: MainEffect) -> str:
    test = effect.test
    return f"{test.difference:+.2f} ({test.low:+.2f} to {test.high:+.2f})"


def average_course(screening: Screening) -> dict[tuple[str, str], list[float]]:
    """Training of the two recipes: means over rooms and seeds in each fifth of a run."""
    course = {}
    for title, (key, _) in _COURSES.items():
        for recipe, row in (("2019", 0), ("default", -1)):
            values = np.array([mark_gaps(getattr(block[row], key)) for block in screening.runs.values()])
            fifths = values.reshape(len(values), FIFTHS, BINS // FIFTHS)
            course[title, recipe] = np.nanmean(fifths, axis=(0, 2)).tolist()
    return course


def draw_effects(effects: Sequence[MainEffect], theme: Theme) -> Figure:
    """Draw the main effects on the slope with their intervals, largest first; dots are rooms."""
    ordered = sorted(effects, key=lambda effect: effect.test.difference)

    def draw(axes: Axes) -> None:
        for number, effect in enumerate(ordered):
            colour = theme.lines[0] if effect.is_shown else theme.muted
            axes.plot(effect.rooms, [number - 0.27] * len(effect.rooms), ".", color=colour, alpha=0.6, markersize=4)
            axes.plot([effect.test.low, effect.test.high], [number] * 2, color=colour, linewidth=2)
            axes.plot(effect.test.difference, number, "o", color=colour, markersize=7)
        axes.axvline(0, color=theme.ink, linewidth=0.8)
        axes.set_yticks(range(len(ordered)), [effect.factor for effect in ordered])
        axes.set(xlabel="change of the slope of efficiency over a run")
        axes.xaxis.set_major_formatter("{x:+.1f}")

    return make_figure(theme, draw, height=4.0, grid="x")
