"""Learning from marks across rooms: a learner with memory, searchers that learn nothing, and who reads the code."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.protocols import compute_learned_share
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.names import join_words
from hrl_escape.sets.benchmark import load_benchmark
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Page, Study
from studies.unseen import get_unseen, make_streams, play_agent

__all__ = ["LINES", "Args", "Cells", "MarksRun", "analyse", "gather", "measure", "run_once", "tell", "tell_all"]

ALIKE = 0.1
"""Efficiency within which the control counts as at the searcher's level."""
COLUMNS = 4
"""Panels in a row of the figure."""
RISE, FEW = 0.2, 16
"""Gain in efficiency that counts as learned across rooms, from so few training rooms to the most."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    runs: int | None = None
    """Training seeds; those of `study.toml` by default."""
    first_seed: int = 0
    """Lowest training seed."""
    workers: int = 1
    """Runs at a time."""


@dataclasses.dataclass(frozen=True)
class MarksRun:
    """A run, tested in unseen rooms.

    Attributes:
        agent: name with traits.
        rung: rung of training and test, with its benchmark: `marks-1/told`.
        rooms: number of training rooms; 0 for who does not learn.
        seed: of training.
        primitives: training budget.
        tested: number of unseen rooms, an episode each.
        efficiency: mean over these.
        escapes: share of episodes that escaped.
    """

    agent: str
    rung: str
    rooms: int
    seed: int
    primitives: int
    tested: int
    efficiency: float
    escapes: float

    @property
    def place(self) -> tuple[str, str, int, int]:
        """Subject of the line."""
        return self.agent, self.rung, self.rooms, self.seed


LINES = (MarksRun,)


# --- runs ------------------------------------------------------------------------------------


def run_once(agent: str, rung: str, rooms: int, seed: int, primitives: int, tested: int, streams: int = 0) -> MarksRun:
    """Train an agent in the first rooms of a rung, so many of them at once, and test it in others.

    Who does not learn is only tested; with 0 `streams`, one episode follows the other.
    """
    spec, (benchmark, name) = AgentSpec.parse(agent), rung.split("/")
    train_in = (make_streams(benchmark, name, rooms, streams, agent) if streams else
                load_benchmark(benchmark)[name].train[:rooms])
    efficiency, escapes = play_agent(spec, get_unseen(benchmark, name, tested), train_in, seed, primitives)
    if spec.is_reference:
        rooms = primitives = 0
    return MarksRun(agent, rung, rooms, seed, primitives, tested, efficiency, escapes)


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing: searchers and ceiling once, the learners with every number of rooms and every seed."""
    data, console = study.data, Console(stderr=True, highlight=False)
    seeds = range(args.first_seed, args.first_seed + (args.runs or data["runs"]))
    jobs: dict[tuple[str, str, int, int], tuple[int, ...]] = {}  # a place; primitives, and rooms at once
    for kind in data["kind"]:
        rungs, sizes = (kind["told"], kind["control"]), kind["sizes"]
        jobs |= {(agent, rung, 0, 0): (0, 0) for agent in (*data["searchers"], data["ceiling"]) for rung in rungs}
        cells = [*((kind["told"], size) for size in sizes), (kind["control"], sizes[-1])]
        for learning in (kind, *([kind["less"]] if "less" in kind else [])):
            budget = learning["primitives"], learning.get("streams", 0)
            jobs |= {(learning["learner"], rung, size, seed): budget for rung, size in cells for seed in seeds}
    known = {run.place for run in store.load()}
    with ProcessPoolExecutor(args.workers, get_fork_server()) as pool:
        open_jobs = [pool.submit(run_once, *job, primitives, data["tested"], streams)
                     for job, (primitives, streams) in jobs.items() if job not in known]
        for done, job in enumerate(as_completed(open_jobs), 1):
            run = job.result()
            store.add([run])
            console.print(f"[{done}/{len(open_jobs)}] {run.agent}, {run.rung}, {run.rooms} rooms, seed {run.seed}: "
                          f"{run.efficiency:.3f}", markup=False)


# --- findings --------------------------------------------------------------------------------


class Cells(NamedTuple):
    """Efficiencies that the sentences read.

    Attributes:
        told: by number of training rooms, of each run.
        control: of each run whose marks are shuffled, or places scattered.
        searcher: of the best searcher that learns nothing, where marks are true.
        control_searcher: likewise where they are shuffled.
        ceiling: of who knows the code.
        kind: of regularity, as `study.toml` has it.
        less: of each run in the most rooms of the learner with a smaller budget; None where there is none.
    """

    told: dict[int, np.ndarray]
    control: np.ndarray
    searcher: float
    control_searcher: float
    ceiling: float
    kind: Mapping[str, Any]
    less: np.ndarray | None = None


def gather(study: Study, lines: Sequence[MarksRun]) -> dict[str, Cells]:
    """Sort lines into cells, by title of the kind of regularity; kinds of which runs are missing are left out.

    Raises:
        ComparisonError: runs of every kind are missing, so that nothing can be said.
    """
    data = study.data

    def pick(agents: Sequence[str], rung: str, rooms: int) -> np.ndarray:
        return np.array([line.efficiency for line in sorted(lines, key=lambda line: line.seed)
                         if line.agent in agents and line.rung == rung and line.rooms == rooms])

    found = {}
    for kind in data["kind"]:
        told = {size: pick([kind["learner"]], kind["told"], size) for size in kind["sizes"]}
        control = pick([kind["learner"]], kind["control"], kind["sizes"][-1])
        searched = [pick(data["searchers"], kind[rung], 0) for rung in ("told", "control")]
        ceiling = pick([data["ceiling"]], kind["told"], 0)
        less = pick([kind["less"]["learner"]], kind["told"], max(told)) if "less" in kind else np.array([])
        if min(map(len, (*told.values(), control))) >= 2 and all(map(len, (*searched, ceiling))):
            found[kind["title"]] = Cells(told, control, searched[0].max(), searched[1].max(), ceiling[0],
                                         kind, less if len(less) >= 2 else None)
    if not found:
        raise ComparisonError("two runs of every cell, the searchers and the ceiling are needed to tell of marks")
    return found


def _bound(values: np.ndarray, level: float = 0.95) -> tuple[float, float, float]:
    """Mean with Student's interval; no narrower than one test episode in a thousand."""
    mean, error = float(np.mean(values)), max(float(stats.sem(values)), 1e-3)
    reach = error * float(stats.t.ppf((1 + level) / 2, len(values) - 1))
    return mean, mean - reach, mean + reach


def _pair(cells: Cells, size: int) -> np.ndarray:
    """Gain of each seed that was run in so many rooms and in the most."""
    few, many = cells.told[size], cells.told[max(cells.told)]
    return many[: len(few)] - few[: len(many)]


def tell(cells: Cells) -> list[str]:
    """Sentences on what the runs show, the headline first."""
    clue, shuffled = _name_clue(cells.kind)
    sizes = sorted(cells.told)
    many = sizes[-1]
    end, low, high = _bound(cells.told[many])
    share = compute_learned_share(end, cells.searcher, cells.ceiling)
    start = f"Trained in {many:,} rooms, the learner has an efficiency of {end:.2f} in rooms that it has never seen"
    bar = f"the best search baseline ({cells.searcher:.2f})"
    worth = stats.ttest_ind(cells.told[many], cells.control, equal_var=False).confidence_interval()
    if low > cells.searcher:
        headline = f"What {clue} mean is learned across rooms. {start}, above {bar}"
    else:
        learned = (f"Some of what {clue} mean is learned, not enough to beat searching." if worth.low > 0 else
                   f"What {clue} mean is not shown to be learned.")
        headline = f"{learned} {start}, " + (f"below {bar}" if high < cells.searcher else f"and {bar} is as good")
    headline += (f"; the Bayes planner has {cells.ceiling:.2f}"
                 + ("." if share is None else f", so its learned share is {share:.0%}."))
    sentences = [headline]
    for size in sizes[:-1]:
        rise, least, most = _bound(_pair(cells, size))
        interval = f"{rise:+.2f} ({least:+.2f} to {most:+.2f})"
        sentences.append(
            f"From {size:,} to {many:,} training rooms efficiency rises by {interval}." if least > 0 else
            f"From {size:,} to {many:,} training rooms efficiency falls by {interval}." if most < 0 else
            f"From {size:,} to {many:,} training rooms no change is shown: {interval}.")
        mean, _, highest = _bound(cells.told[size])
        if highest < cells.searcher:
            sentences.append(
                f"Trained in {size:,} room{'s' * (size > 1)} it is worse than the searcher, with {mean:.2f}.")
    if high > cells.ceiling + 0.01:
        sentences.append(f"The interval of the learner ({low:.2f} to {high:.2f}) reaches above the Bayes planner.")
    mean, low, high = _bound(cells.control - cells.control_searcher)
    control = (f"With {clue} {shuffled} the same learner has {np.mean(cells.control):.2f}, where the searcher has "
               f"{cells.control_searcher:.2f}")
    sentences.append(
        f"{control}: {clue} that say nothing lift it above the searcher, so something else carries over."
        if low > 0 else
        f"{control}: at the searcher's level." if low > -ALIKE else
        f"{control}: below the searcher." if high < 0 else f"{control}: the runs differ too much to say more.")
    sentences.append(f"True {clue} are worth {np.mean(cells.told[many]) - np.mean(cells.control):+.2f} "
                     f"({worth.low:+.2f} to {worth.high:+.2f}) against {shuffled} ones.")
    if cells.less is not None:
        gain = stats.ttest_ind(cells.told[many], cells.less, equal_var=False).confidence_interval()
        interval = f"{end - np.mean(cells.less):+.2f} ({gain.low:+.2f} to {gain.high:+.2f})"
        larger, smaller = _describe_training(cells.kind), _describe_training(cells.kind["less"])
        sentences.append(f"{larger} gains {interval} over {smaller}, which reached "
                         f"{np.mean(cells.less):.2f}." if gain.low > 0 else
                         f"{larger} is not shown to gain over {smaller}: {interval}.")
    return sentences


def _name_clue(kind: Mapping[str, Any]) -> tuple[str, str]:
    """Name of the clue that tells of the order, and of what is done to it in the control."""
    return kind.get("clue", "marks"), kind.get("shuffled", "shuffled")


def _describe_training(learning: Mapping[str, Any]) -> str:
    """A learner, its budget and the rooms that it learns from at once."""
    streams = learning.get("streams", 0)
    rooms = f"{streams} rooms at once" if streams else "one room at a time"
    return f"`{learning['learner']}` with {learning['primitives']:,} primitives in {rooms}"


def has_risen(cells: Cells) -> bool:
    """True if runs show a rise by `RISE` from `FEW` rooms to the most, to above the searcher and below the ceiling."""
    _, least, _ = _bound(_pair(cells, FEW))
    _, _, high = _bound(cells.told[max(cells.told)])
    return least >= RISE and is_above(cells) and high < cells.ceiling


def is_above(cells: Cells) -> bool:
    """True if runs in the most rooms are shown to be above the best searcher."""
    return _bound(cells.told[max(cells.told)])[1] > cells.searcher


def tell_all(found: Mapping[str, Cells], tested: int) -> str:
    """Headline over all kinds: where learners beat searching, and where more rooms are shown to teach more.

    Args:
        found: cells by title of the kind.
        tested: number of unseen rooms, the same of all runs, so that intervals are over training seeds alone.
    """
    most = max(size for cells in found.values() for size in cells.told)
    above = sum(map(is_above, found.values()))
    risen = [title.lower() for title, cells in found.items() if has_risen(cells)]
    others = [title.lower() for title in found if title.lower() not in risen]
    beaten = (f"In these {tested} unseen rooms the learner is above the best search baseline in {above} of "
              f"{len(found)} kinds. Intervals are over training seeds, so they do not cover other rooms. ")
    claim = (f"efficiency rises by {RISE} or more from {FEW} to {most:,} training rooms, to above the searcher and "
             "below the Bayes planner")
    if not risen:
        return f"{beaten}In none is it shown that {claim}."
    rest = f"; with {join_words(others)} this is not shown" if others else ""
    return f"{beaten}With {join_words(risen)} {claim}{rest}."


def analyse(study: Study, lines: Sequence[MarksRun]) -> Page:
    """Sentences, tables and figure."""
    found, data = gather(study, lines), study.data
    rows, parts = [], []
    for kind in (kind for kind in data["kind"] if kind["title"] in found):
        cells = found[kind["title"]]
        headline, *sentences = tell(cells)
        parts.append({**kind, "headline": headline, "sentences": sentences})
        rows += [[f"{kind['told']}, {size:,} room{'s' * (size > 1)}", *_describe(values, cells.searcher, cells.ceiling)]
                 for size, values in cells.told.items()]
        if cells.less is not None:
            rows.append([f"{kind['told']}, {max(cells.told):,} rooms, smaller budget",
                         *_describe(cells.less, cells.searcher, cells.ceiling)])
        rows.append([kind["control"], *_describe(cells.control, cells.control_searcher, None)])
        rows += [[f"{rung}, {name}", "", f"{value:.3f}", "", ""] for rung, name, value in (
            (kind["told"], "searcher", cells.searcher), (kind["control"], "searcher", cells.control_searcher),
            (kind["told"], "Bayes planner", cells.ceiling))]
    headline = tell_all(found, data["tested"])
    return Page({"headline": headline, "parts": parts, "table": make_table(
        ["", "runs", "efficiency in unseen rooms", "runs from ... to", "learned share"], rows), **data},
        {"marks": draw(found)}, [headline, *(f"{part['title']}: {part['headline']}" for part in parts)])


def _describe(values: np.ndarray, searcher: float, ceiling: float | None) -> list[str]:
    mean, low, high = _bound(values)
    share = None if ceiling is None else compute_learned_share(mean, searcher, ceiling)
    return [str(len(values)), f"{mean:.3f} ({low:.3f} to {high:.3f})", f"{values.min():.2f} to {values.max():.2f}",
            "" if share is None else f"{share:.2f}"]


def draw(found: Mapping[str, Cells]) -> Figure:
    """Efficiency against training rooms, a panel a kind and a dot a run; searcher and ceiling as lines."""
    with matplotlib.rc_context(FIGURE_STYLE):
        rows = -(-(len(found) + 1) // COLUMNS)  # the legend has a place of its own
        figure = Figure(figsize=(2.6 * COLUMNS, 3.0 * rows), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).ravel()
        for axes, (title, cells) in zip(panels, found.items(), strict=False):
            sizes, last = sorted(cells.told), len(cells.told) - 1
            for place, values, colour in (*((number, cells.told[size], 0) for number, size in enumerate(sizes)),
                                          (last + 0.08, cells.control, 1)):
                axes.scatter([place] * len(values), values, s=14, alpha=0.5, color=palette.LINES[colour], linewidths=0)
            axes.plot(range(len(sizes)), [cells.told[size].mean() for size in sizes], "o-", color=palette.LINES[0],
                      label="true marks or places")
            axes.plot([last + 0.08], [cells.control.mean()], "s", color=palette.LINES[1],
                      label="marks shuffled, places scattered")
            axes.axhline(cells.ceiling, color=palette.INK, linewidth=1, label="Bayes planner: is given what they mean")
            axes.axhline(cells.searcher, color=palette.MUTED, linewidth=1, linestyle="--",
                         label="best searcher that learns nothing")
            axes.set(title=title, xlabel="training rooms", ylim=(0, 1.03))
            finish_axes(axes)
            axes.set_xticks(range(len(sizes)), [f"{size:,}" for size in sizes])
        for first in panels[: len(found) : COLUMNS]:
            first.set_ylabel("efficiency in unseen rooms")
        for axes in panels[len(found):]:
            axes.set_axis_off()
        panels[-1].legend(*panels[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure
