"""First escape against buttons: runs that end with their first escape, growth as a power law, and one figure."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator
from numpy.typing import NDArray
from rich.console import Console
from studies.price.words import tell_factor

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.inference import ALPHA
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.pictures import palette
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from hrl_escape.names import join_words
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.price.ratios import CostRatio, LogRange, Middle, correct_prices, find_middle
from studies.running import StudyArgs
from studies.scaling.results import RoomKind
from studies.scaling.rounds import make_room
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "EscapeRun", "FirstEscape", "Growth", "advise", "analyse", "compare_searchers",
           "find_first_escape", "find_reach", "fit_growth", "measure", "run_once", "tell_growth", "tell_reach",
           "tell_searchers"]

RESAMPLES = 2_000
LEAST_SIZES = 4
"""Sizes from which a growth is fitted."""
SURE = 0.95
"""Share of resamples in which one law must fit better than the other to be told."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    agents: tuple[str, ...] = ()
    """Agents to run; all by default."""
    runs: int | None = None
    """Runs of each agent with each number of buttons; those of `study.toml` by default."""
    workers: int = 1
    """Runs at a time."""
    first_seed: int = 0
    """Lowest seed of rooms and training."""


@dataclasses.dataclass(frozen=True)
class EscapeRun:
    """A run until its first escape.

    Attributes:
        agent: name with traits.
        buttons: number of buttons.
        width: of the room, m.
        run: seed of room, agent and episodes.
        budget: most primitives; the last decision may go beyond.
        first_escape: primitives at the end of the first episode that escaped; None if none did.
    """

    agent: str
    buttons: int
    width: float
    run: int
    budget: int
    first_escape: int | None

    @property
    def place(self) -> tuple[str, int, float, int]:
        """Subject of the line."""
        return self.agent, self.buttons, self.width, self.run


LINES = (EscapeRun,)


class FirstEscape:
    """Probe that ends a run with its first escape."""

    def __init__(self) -> None:
        self.is_done = False

    @property
    def identity(self) -> dict[str, Any]:
        """The stopping rule."""
        return {"until": "first escape"}

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Nothing to measure."""

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Look at the episode's end."""
        self.is_done = self.is_done or bool(episode.success)

    def state_dict(self) -> StateTree:
        """The flag of an escape."""
        return {"is_done": self.is_done}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""
        self.is_done = bool(state["is_done"])


# --- runs ------------------------------------------------------------------------------------


def run_once(agent: str, room: RoomConfig, buttons: int, seed: int, budget: int) -> EscapeRun:
    """Run an agent in a room of its own until its first escape, or to the end of the budget."""
    first = find_first_escape(agent, generate(room, seed), seed, budget)
    return EscapeRun(agent, buttons, room.room.width, seed, budget, first)


def find_first_escape(agent: str, room: RoomInstance, seed: int, budget: int) -> int | None:
    """Primitives at the end of an agent's first episode that escapes; None if none does within the budget."""
    spec = AgentSpec.parse(agent)
    env, recorder = make_agent_env(spec, room, "objects" if "objects" in agent else "features")
    try:
        player = make_reference(spec.name, env, recorder) if spec.is_reference else spec.name
        result = train(player, env, primitives=budget, seed=seed, settings=None if spec.is_reference else spec.settings,
                       eval_episodes=0, probe=FirstEscape(), progress=False)
    finally:
        env.close()
    return result.first_escape


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, size by size; an agent whose runs all failed with fewer buttons does not run with more."""
    data, console = study.data, Console(stderr=True, highlight=False)
    seeds = range(args.first_seed, args.first_seed + (args.runs or data["runs"]))
    with ProcessPoolExecutor(args.workers, get_fork_server()) as pool:
        for agent in args.agents or data["agents"]:
            for size in data["sizes"]:
                known = {run.place: run for run in store.load()}
                room = make_room(RoomKind(data["graph"], size, data["rule"]), data["width"])
                jobs = [pool.submit(run_once, agent, room, size, seed, data["budget"])
                        for seed in seeds if (agent, size, data["width"], seed) not in known]
                for job in as_completed(jobs):
                    store.add([job.result()])
                ends = [run.first_escape for run in store.load()
                        if (run.agent, run.buttons, run.width) == (agent, size, data["width"])]
                escaped = sum(end is not None for end in ends)
                console.print(f"{agent}, {size} buttons: {escaped} of {len(ends)} runs escaped", markup=False)
                if not escaped:
                    break


# --- growth ----------------------------------------------------------------------------------


class Growth(NamedTuple):
    """Growth of the primitives to the first escape with the number of buttons.

    Attributes:
        exponent: k of the power law, primitives = c n^k.
        low: lower end of its 95 % interval.
        high: upper end.
        factor: c.
        power: share of resamples in which the power law fits better than an exponential.
        largest: most buttons that were fitted.
        band: (buttons, low, high), the 95 % interval of the law at each number of buttons that was fitted.
    """

    exponent: float
    low: float
    high: float
    factor: float
    power: float
    largest: int
    band: tuple[tuple[float, float, float], ...] = ()


def list_times(runs: Sequence[EscapeRun]) -> dict[int, NDArray[np.float64]]:
    """Primitives to the first escape by number of buttons, infinite where none came: where their median is finite."""
    sizes = sorted({run.buttons for run in runs})
    times = {size: np.array([math.inf if run.first_escape is None else run.first_escape
                             for run in runs if run.buttons == size]) for size in sizes}
    return {size: values for size, values in times.items() if np.isfinite(np.median(values))}


def find_reach(runs: Sequence[EscapeRun]) -> int | None:
    """Most buttons with which at least half of the runs escape; None for none."""
    ends: dict[int, list[bool]] = {}
    for run in runs:
        ends.setdefault(run.buttons, []).append(run.first_escape is not None)
    return max((size for size, own in ends.items() if 2 * sum(own) >= len(own)), default=None)


def fit_growth(runs: Sequence[EscapeRun], rng: np.random.Generator) -> Growth | None:
    """Fit medians over runs by least squares of logarithms; runs are resampled within each number of buttons.

    Returns:
        None with fewer than `LEAST_SIZES` numbers of buttons with which more than half of the runs escape.
    """
    times = list_times(runs)
    if len(times) < LEAST_SIZES:
        return None
    sizes = np.array(list(times), float)
    draws = [[rng.choice(values, len(values)) for values in times.values()] for _ in range(RESAMPLES)]
    medians = np.array([[np.median(values) for values in times.values()],
                        *np.transpose([np.median(each, axis=1) for each in zip(*draws, strict=True)])])
    slopes, starts, errors = _fit_lines(np.log(sizes), medians)
    factors, better = np.exp(starts), errors < _fit_lines(sizes, medians)[-1]
    low, high = np.quantile(slopes[1:], [0.025, 0.975])
    ends = np.quantile(factors[1:, None] * sizes ** slopes[1:, None], [0.025, 0.975], axis=0)
    return Growth(float(slopes[0]), float(low), float(high), float(factors[0]), float(better[1:].mean()),
                  int(sizes[-1]), tuple(zip(sizes.tolist(), *ends.tolist(), strict=True)))


def _fit_lines(x: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Slopes, heights at 0 and squared errors (rows,) of the logarithms of each row's finite values (rows, sizes)."""
    kept = np.isfinite(values)
    y, count = np.log(np.where(kept, values, 1.0)), np.maximum(kept.sum(axis=1), 1)
    middle = (kept @ x) / count
    away = np.where(kept, x - middle[:, None], 0.0)
    slope = (away * y).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1e-12)
    start = y.sum(axis=1) / count - slope * middle
    return slope, start, (np.where(kept, start[:, None] + slope[:, None] * x - y, 0.0) ** 2).sum(axis=1)


def tell_reach(largest: Mapping[str, int | None], words: Mapping[str, str], most: int) -> str:
    """One sentence: who still escapes with the most buttons, and beyond how many the others do in few runs.

    Args:
        largest: agent -> most buttons with which at least half of the runs escape; None for none.
        words: agent -> what it stands for.
        most: buttons in the largest rooms.
    """
    arrived = [words[agent] for agent, reach in largest.items() if reach == most]
    stops: dict[int, list[str]] = {}
    for agent, reach in largest.items():
        if reach != most:
            stops.setdefault(reach or 0, []).append(words[agent])
    there = f"{join_words(arrived) or 'nobody'} still escape{'' if len(arrived) > 1 else 's'} with {most} buttons"
    rest = [f"of {join_words(names)} {'' if number else 'escape '}"
            + (f"beyond {reach} buttons" if reach else "with any number of buttons")
            for number, (reach, names) in enumerate(sorted(stops.items())[::-1])]
    return (there[0].upper() + there[1:]) + ("; fewer than half of the runs " + join_words(rest) if rest else
                                             "") + "."


def tell_growth(growths: Mapping[str, Growth | None], largest: Mapping[str, int | None], words: Mapping[str, str],
                most: int) -> Iterator[str]:
    """Sentences on who escapes with how many buttons, and how the price grows.

    Args:
        growths: agent -> fit.
        largest: agent -> most buttons with which at least half of the runs escape; None for none.
        words: agent -> what it stands for.
        most: buttons in the largest rooms.
    """
    for agent, word in words.items():
        if agent not in largest:
            continue
        reach = largest[agent]
        if reach is None:
            yield f"**{word}** (`{agent}`): fewer than half of the runs escape, however few the buttons."
            continue
        text = f"**{word}** (`{agent}`): half of the runs or more escape with up to {reach} of {most} buttons"
        growth = growths[agent]
        if growth is None:
            yield f"{text}."
            continue
        law = ("; a power law fits better than an exponential" if growth.power >= SURE else
               "; an exponential fits better than a power law" if growth.power <= 1 - SURE else
               "; these sizes do not tell a power law from an exponential")
        yield (f"{text}; up to {growth.largest} buttons the number of primitives grows as n^{growth.exponent:.1f} "
               f"({growth.low:.1f} to {growth.high:.1f}){law}.")


def compare_searchers(of: Mapping[str, Sequence[EscapeRun]], largest: Mapping[str, int | None], most: int
                      ) -> dict[tuple[str, str], Middle]:
    """Ratios of the primitives that each searcher and each learner need with the most buttons, room by room.

    Only who escapes there in half of the rooms or more is compared; all ratios are one family (Holm).
    """
    arrived = [agent for agent, reach in largest.items() if reach == most]
    waits = {agent: {run.run: (math.log(run.first_escape or run.budget), run.first_escape is not None)
                     for run in of[agent] if run.buttons == most} for agent in arrived}
    searchers = [agent for agent in arrived if AgentSpec.parse(agent).is_reference]
    ratios = {(searcher, learner): CostRatio(most, logs, find_middle(list(logs.values())))
              for searcher in searchers for learner in arrived if learner not in searchers
              if (logs := {run: _subtract(waits[searcher][run], waits[learner][run])
                           for run in sorted(waits[searcher].keys() & waits[learner].keys())})}
    (corrected,), _ = correct_prices([list(ratios.values())])
    return {pair: ratio.middle for pair, ratio in zip(ratios, corrected, strict=True)}


def _subtract(one: tuple[float, bool], other: tuple[float, bool]) -> LogRange:
    return (-math.inf if not other[1] else one[0] - other[0]), (math.inf if not one[1] else one[0] - other[0])


def tell_searchers(ratios: Mapping[tuple[str, str], Middle], words: Mapping[str, str], most: int) -> Iterator[str]:
    """A sentence a ratio."""
    for (searcher, learner), middle in ratios.items():
        told = (f"needs {tell_factor(middle)} times the primitives of" if middle.p < ALPHA else
                "is not shown to need more or fewer primitives than")
        yield (f"With {most} buttons **{words[searcher]}** {told} **{words[learner]}** until its first escape, room by "
               "room.")


def advise(ratios: Mapping[tuple[str, str], Middle], words: Mapping[str, str], most: int) -> str:
    """Advice to a user, by whether a learner is shown to need fewer primitives than searching."""
    cheaper = [words[learner] for (_, learner), middle in ratios.items() if middle.p < ALPHA and middle.low > 1]
    if cheaper:
        return (f"Begin with {join_words(cheaper)}: with {most} buttons it needs fewer primitives than a searcher that "
                "learns nothing, which is what a learner has to show.")
    if not ratios:
        return f"With {most} buttons no learner stands beside a searcher, so compare them where both escape."
    return ("Compare your learner with the searcher, not with chance: the searcher keeps a list of what it has tried, "
            "forgets it after each episode, and learns nothing. What it needs is the price of finding the order in a "
            f"new room; no learner here is shown to need less with {most} buttons, so yours has to, or to keep what it "
            "found.")


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[EscapeRun]) -> Page:
    """Sentences, table and figure.

    Raises:
        ComparisonError: there are no runs.
    """
    lines = [run for run in lines if run.width == study.data["width"]]
    if not lines:
        raise ComparisonError("there are no runs to tell of")
    words: Mapping[str, str] = study.data["agents"]
    of = {agent: own for agent in words if (own := [run for run in lines if run.agent == agent])}
    sizes = study.data["sizes"]
    room = make_room(RoomKind(study.data["graph"], sizes[0], study.data["rule"]), study.data["width"])
    growths = {agent: fit_growth(own, np.random.default_rng(0)) for agent, own in of.items()}
    largest = {agent: find_reach(own) for agent, own in of.items()}
    rows = [[f"{words[agent]} (`{agent}`)", *(_describe([run for run in own if run.buttons == size])
                                              for size in sizes)] for agent, own in of.items()]
    ratios = compare_searchers(of, largest, max(sizes))
    sentences = [*tell_growth(growths, largest, words, max(sizes)), *tell_searchers(ratios, words, max(sizes))]
    headline = tell_reach(largest, words, max(sizes))
    return Page({"headline": headline, "advice": advise(ratios, words, max(sizes)),
                 "sentences": sentences, "table": make_table(["agent", *map(str, sizes)], rows),
                 "runs": max(sum(run.buttons == sizes[0] for run in own) for own in of.values()),
                 "width": study.data["width"], "horizon": room.horizon,
                 "budget": study.data["budget"], "graph": study.data["graph"], "rule": study.data["rule"]},
                {"buttons": draw(of, growths, words)}, [headline, *sentences])


def _describe(runs: Sequence[EscapeRun]) -> str:
    if not runs:
        return "—"
    times = [math.inf if run.first_escape is None else run.first_escape for run in runs]
    middle = float(np.median(times))
    return f"{sum(map(math.isfinite, times))} of {len(times)}; {'never' if math.isinf(middle) else f'{middle:,.0f}'}"


def draw(of: Mapping[str, Sequence[EscapeRun]], growths: Mapping[str, Growth | None], words: Mapping[str, str]
         ) -> Figure:
    """Medians and runs against buttons, both logarithmic, with the fits that no exponential surpasses."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.6, 4.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.add_subplot()
        budget, rows = max(run.budget for own in of.values() for run in own), 0
        for number, (agent, own) in enumerate(of.items()):
            colour = palette.LINES[number]
            dots = [(run.buttons, run.first_escape) for run in own if run.first_escape is not None]
            axes.scatter(*zip(*dots, strict=True) if dots else ([], []), s=9, alpha=0.35, color=colour, linewidths=0)
            times, growth = list_times(own), growths[agent]
            if growth is not None and growth.power <= 1 - SURE:
                growth = None
            label = words[agent] if growth is None else (
                f"{words[agent]}\n$n^{{{growth.exponent:.1f}}}$  ({growth.low:.1f} to {growth.high:.1f})")
            axes.plot(list(times), [np.median(values) for values in times.values()], "o-", color=colour, markersize=5,
                      linewidth=1.8, label=label)
            if growth is not None:
                at, low, high = zip(*growth.band, strict=True)
                axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0)
            failed = Counter(run.buttons for run in own if run.first_escape is None)
            for size, count in failed.items():
                axes.text(size, 1.03 + 0.055 * rows, str(count), color=colour, ha="center", fontsize=8,
                          transform=axes.get_xaxis_transform())
            rows += bool(failed)
        axes.axhline(budget, color=palette.MUTED, linestyle=":", linewidth=1)
        if rows:
            axes.text(1.03, 1.03, f"runs without an escape\nwithin {budget:,} primitives", color=palette.MUTED,
                      fontsize=8, transform=axes.transAxes)
        finish_axes(axes)
        sizes = sorted({run.buttons for own in of.values() for run in own})
        axes.set(xscale="log", yscale="log", xlabel="buttons", ylabel="primitives to the first escape")
        axes.set_ylim(top=1.05 * budget)
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, labelspacing=1.0)
    return figure
