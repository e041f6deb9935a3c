"""Learning from marks across rooms: a learner with memory, searchers that learn nothing, and who reads the code."""

from __future__ import annotations

import dataclasses
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.ladder_score import compute_learned_share
from hrl_escape.comparison.references.registry import make_reference
from hrl_escape.comparison.runs import make_env
from hrl_escape.env.drawing import palette
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import ComparisonError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.planning.best_known import find_best_known
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "Cells", "MarksRun", "analyse", "gather", "measure", "run_once", "tell"]

ALIKE = 0.1
"""Efficiency within which the control counts as at the searcher's level."""


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
        rung: rung of training and test.
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


@lru_cache(maxsize=8)
def _get_sets(benchmark: str, rung: str, tested: int) -> tuple[InstanceSet, InstanceSet, tuple[float, ...]]:
    """Rooms to learn in, rooms to be tested in, and the fewest known primitives of each of these."""
    found = load_benchmark(benchmark)[rung]
    test = found.test[:tested]
    known = [find_best_known(room, Kinematics(room).make_state(room.starts[0])).primitives for room in test]
    return found.train, test, tuple(float(fewest or 0) for fewest in known)


def run_once(benchmark: str, agent: str, rung: str, rooms: int, seed: int, primitives: int, tested: int) -> MarksRun:
    """Train an agent in the first rooms of a rung, and test it in others; who does not learn is only tested."""
    spec = AgentSpec.parse(agent)
    train_set, test_set, fewest = _get_sets(benchmark, rung, tested)
    order = {str(compute_episode_seed(0, "evaluation", number)): number for number in range(tested)}
    test_env, recorder = make_env(spec, test_set, "objects", order)
    player: Agent | None
    if spec.is_reference:
        player = make_reference(spec.name, test_env, recorder)
    else:
        env, _ = make_env(spec, train_set[:rooms], "objects")
        player = train(spec.name, env, primitives=primitives, seed=seed, settings=spec.settings, eval_episodes=0,
                       progress=False).agent
        env.close()
    assert player is not None  # a run without a folder gives its agent back
    found = evaluate(player, test_env, tested)
    test_env.close()
    scores = [success * min(1.0, best / length)
              for success, best, length in zip(found.successes, fewest, found.lengths, strict=True)]
    return MarksRun(agent, rung, 0 if spec.is_reference else rooms, seed, 0 if spec.is_reference else primitives,
                    tested, round(float(np.mean(scores)), 4), round(float(np.mean(found.successes)), 4))


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing: searchers and ceiling once, the learner seed by seed with every number of rooms."""
    data, console = study.data, Console(stderr=True, highlight=False)
    jobs = [(agent, rung, 0, 0) for agent in (*data["searchers"], data["ceiling"])
            for rung in (data["told"], data["control"])]
    for seed in range(args.first_seed, args.first_seed + (args.runs or data["runs"])):
        jobs += [(data["learner"], data["told"], size, seed) for size in data["sizes"]]
        jobs.append((data["learner"], data["control"], data["sizes"][-1], seed))
    known = {run.place for run in store.load()}
    with ProcessPoolExecutor(args.workers, multiprocessing.get_context("spawn")) as pool:
        open_jobs = [pool.submit(run_once, data["benchmark"], *job, data["primitives"], data["tested"])
                     for job in jobs if job not in known]
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
        control: of each run with shuffled marks.
        searcher: of the best searcher that learns nothing, where marks are true.
        control_searcher: likewise where they are shuffled.
        ceiling: of who knows the code.
    """

    told: dict[int, np.ndarray]
    control: np.ndarray
    searcher: float
    control_searcher: float
    ceiling: float


def gather(study: Study, lines: Sequence[MarksRun]) -> Cells:
    """Sort lines into cells.

    Raises:
        ComparisonError: runs are missing without which nothing can be said.
    """
    data = study.data

    def pick(agents: Sequence[str], rung: str, rooms: int) -> np.ndarray:
        return np.array([line.efficiency for line in lines
                         if line.agent in agents and line.rung == rung and line.rooms == rooms])

    told = {size: pick([data["learner"]], data["told"], size) for size in data["sizes"]}
    control = pick([data["learner"]], data["control"], data["sizes"][-1])
    searched = [pick(data["searchers"], rung, 0) for rung in (data["told"], data["control"])]
    ceiling = pick([data["ceiling"]], data["told"], 0)
    if min(map(len, (*told.values(), control))) < 2 or not all(map(len, (*searched, ceiling))):
        raise ComparisonError("two runs of every cell, the searchers and the ceiling are needed to tell of marks")
    return Cells(told, control, searched[0].max(), searched[1].max(), ceiling[0])


def _bound(values: np.ndarray, level: float = 0.95) -> tuple[float, float, float]:
    """Mean with Student's interval; no narrower than one test episode in a thousand."""
    mean, error = float(np.mean(values)), max(float(stats.sem(values)), 1e-3)
    reach = error * float(stats.t.ppf((1 + level) / 2, len(values) - 1))
    return mean, mean - reach, mean + reach


def tell(cells: Cells) -> list[str]:
    """Sentences on what the runs show, the headline first."""
    sizes = sorted(cells.told)
    many = sizes[-1]
    end, low, high = _bound(cells.told[many])
    share = compute_learned_share(end, cells.searcher, cells.ceiling)
    start = f"Trained in {many:,} rooms, the learner has an efficiency of {end:.2f} in rooms that it has never seen"
    bar = f"the best searcher that learns nothing ({cells.searcher:.2f})"
    if low > cells.searcher:
        headline = f"What marks mean is learned across rooms. {start}, above {bar}"
    elif high < cells.searcher:
        headline = f"What marks mean is not learned. {start}, below {bar}"
    else:
        headline = f"These runs do not show that what marks mean is learned. {start}, and {bar} is as good"
    headline += (f"; the ceiling is {cells.ceiling:.2f}"
                 + ("." if share is None else f", so its learned share is {share:.0%}."))
    sentences = [headline]
    for size in sizes[:-1]:
        gain = cells.told[many][: len(cells.told[size])] - cells.told[size][: len(cells.told[many])]
        rise, least, most = _bound(gain)
        interval = f"{rise:+.2f} ({least:+.2f} to {most:+.2f})"
        sentences.append(
            f"From {size:,} to {many:,} training rooms efficiency rises by {interval}." if least > 0 else
            f"From {size:,} to {many:,} training rooms efficiency falls by {interval}." if most < 0 else
            f"From {size:,} to {many:,} training rooms no change is shown: {interval}.")
    if high > cells.ceiling + 0.01:
        sentences.append(f"The interval of the learner ({low:.2f} to {high:.2f}) reaches above the ceiling.")
    mean, low, high = _bound(cells.control - cells.control_searcher)
    control = (f"With marks shuffled the same learner has {np.mean(cells.control):.2f}, where the searcher has "
               f"{cells.control_searcher:.2f}")
    sentences.append(
        f"{control}: marks that say nothing lift it above the searcher, so something else carries over." if low > 0 else
        f"{control}: at the searcher's level." if low > -ALIKE else
        f"{control}: below the searcher." if high < 0 else f"{control}: the runs differ too much to say more.")
    return sentences


def analyse(study: Study, lines: Sequence[MarksRun]) -> Page:
    """Sentences, table and figure."""
    cells = gather(study, lines)
    told = tell(cells)
    rows = [[f"learner, {size:,} room{'s' * (size > 1)}", *_describe(values, cells.searcher, cells.ceiling)]
            for size, values in cells.told.items()]
    rows.append(["learner, marks shuffled", *_describe(cells.control, cells.control_searcher, None)])
    rows += [[name, f"{value:.3f}", "", ""] for name, value in (
        ("searcher", cells.searcher), ("searcher, marks shuffled", cells.control_searcher), ("ceiling", cells.ceiling))]
    data = study.data
    return Page({"headline": told[0], "sentences": told[1:], "table": make_table(
        ["", "efficiency in unseen rooms", "runs from ... to", "learned share"], rows), **data,
        "shown": len(cells.told[data["sizes"][-1]])}, {"marks": draw(cells)}, told)


def _describe(values: np.ndarray, searcher: float, ceiling: float | None) -> list[str]:
    mean, low, high = _bound(values)
    share = None if ceiling is None else compute_learned_share(mean, searcher, ceiling)
    return [f"{mean:.3f} ({low:.3f} to {high:.3f})", f"{values.min():.2f} to {values.max():.2f}",
            "" if share is None else f"{share:.2f}"]


def draw(cells: Cells) -> Figure:
    """Efficiency against training rooms, a dot a run; searcher and ceiling as lines."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.0, 3.6), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.add_subplot()
        sizes = sorted(cells.told)
        for number, size in enumerate(sizes):
            axes.scatter([number] * len(cells.told[size]), cells.told[size], s=14, alpha=0.5, color=palette.LINES[0],
                         linewidths=0)
        axes.plot(range(len(sizes)), [cells.told[size].mean() for size in sizes], "o-", color=palette.LINES[0],
                  label="marks that tell the rank")
        last = len(sizes) - 1
        axes.scatter([last + 0.08] * len(cells.control), cells.control, s=14, alpha=0.5, color=palette.LINES[1],
                     linewidths=0)
        axes.plot([last + 0.08], [cells.control.mean()], "s", color=palette.LINES[1], label="marks shuffled")
        axes.axhline(cells.ceiling, color=palette.INK, linewidth=1, label="ceiling: knows the code")
        axes.axhline(cells.searcher, color=palette.MUTED, linewidth=1, linestyle="--",
                     label="best searcher that learns nothing")
        axes.set(xlabel="training rooms", ylabel="efficiency in unseen rooms", ylim=(0, 1.03))
        finish_axes(axes)
        axes.set_xticks(range(len(sizes)), [f"{size:,}" for size in sizes])
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
