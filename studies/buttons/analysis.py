"""First escape against buttons: runs that end with their first escape."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from rich.console import Console

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.state import Stateful
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.launching.local import get_fork_server
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.running import StudyArgs
from studies.scaling.results import RoomKind
from studies.scaling.rounds import make_room
from studies.statistics import Difference, compare_signs
from studies.store import Line, Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "EscapeRun", "FirstEscape", "Size", "analyse", "compare_first_escapes",
           "find_first_escape", "find_reach", "measure", "run_once"]


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    agents: tuple[str, ...] = ()
    """Agents to run; all by default."""
    runs: int | None = None
    """Runs of each agent with each number of buttons; from `study.toml` by default."""
    workers: int = 1
    """Runs at a time."""
    first_seed: int = 0
    """Lowest seed of rooms and training."""


@dataclasses.dataclass(frozen=True)
class EscapeRun(Line):
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

    PLACE = ("agent", "buttons", "width", "run")


LINES = (EscapeRun,)


class FirstEscape(Stateful):
    """Probe that ends a run with its first escape."""

    STATE = ("is_done",)

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


# --- findings --------------------------------------------------------------------------------


class Size(NamedTuple):
    """Runs of an agent with some number of buttons.

    Attributes:
        escaped: runs that escaped within the budget.
        made: all runs.
        median: primitives to the first escape; infinite where half of the runs or more do not escape.
    """

    escaped: int
    made: int
    median: float


def find_reach(sizes: Mapping[int, Size]) -> int:
    """Most buttons where at least half of the runs escape; 0 for none."""
    return max((size for size, own in sizes.items() if 2 * own.escaped >= own.made), default=0)


def compare_first_escapes(runs: Sequence[EscapeRun], one: str, other: str, buttons: int) -> Difference:
    """Compare the logarithms of two agents' first escapes, room by room.

    Raises:
        ComparisonError: a run of either did not escape, so that its logarithm is not known.
    """
    ends = {agent: {run.run: run.first_escape for run in runs if (run.agent, run.buttons) == (agent, buttons)}
            for agent in (one, other)}
    pairs = [(ends[one][room], ends[other][room]) for room in sorted(ends[one].keys() & ends[other].keys())]
    gaps = [math.log(first / second) if first and second else math.nan for first, second in pairs]
    if not gaps or any(map(math.isnan, gaps)):
        raise ComparisonError(f"not all runs of {one} and {other} escape with {buttons} buttons")
    return compare_signs({one: gaps})[one]


def analyse(study: Study, lines: Sequence[EscapeRun]) -> Findings:
    """First escapes of each agent by number of buttons.

    Raises:
        ComparisonError: there are no runs, or not all runs of search and of learned structure escape.
    """
    data = study.data
    lines = [run for run in lines if run.width == data["width"]]
    if not lines:
        raise ComparisonError("there are no runs")
    sizes = {agent: {size: _summarise(own) for size in data["sizes"]
                     if (own := [run for run in lines if (run.agent, run.buttons) == (agent, size)])}
             for agent in data["agents"]}
    most = max(data["sizes"])
    gap = compare_first_escapes(lines, data["searcher"], data["structure"], most)
    ratio = SimpleNamespace(mean=math.exp(gap.mean), low=math.exp(gap.low), high=math.exp(gap.high), p=gap.p)
    table = make_table(["agent", *map(str, data["sizes"])], [
        [title, *(_format(sizes[agent].get(size)) for size in data["sizes"])]
        for agent, title in data["agents"].items()])
    return Findings(
        SimpleNamespace(sizes=sizes, ratio=ratio, reach={agent: find_reach(own) for agent, own in sizes.items()},
                        most=most, data=data),
        {"buttons": table}, {"buttons": lambda theme: draw(sizes, data["agents"], data["budget"], theme)})


def _summarise(runs: Sequence[EscapeRun]) -> Size:
    ends = [run.first_escape or math.inf for run in runs]
    return Size(sum(map(math.isfinite, ends)), len(ends), float(np.median(ends)))


def _format(size: Size | None) -> str:
    if size is None:
        return ""
    return f"{size.escaped} of {size.made}; {'never' if math.isinf(size.median) else f'{size.median:,.0f}'}"


def draw(sizes: Mapping[str, Mapping[int, Size]], titles: Mapping[str, str], budget: int, theme: Theme) -> Figure:
    """Draw the median primitives to the first escape; a line ends where half of the runs or more do not."""
    places = ((2.05, 9_000), (4.4, 4_500), (6.2, 45_000), (8.6, 105), (14.5, 2_800))

    def draw_axes(axes: Axes) -> None:
        for (agent, own), place, number in zip(sizes.items(), places, (3, 2, 1, 4, 0), strict=True):
            known = {size: found.median for size, found in own.items() if math.isfinite(found.median)}
            axes.plot(list(known), list(known.values()), "--" if number == 4 else "-", marker="o", markersize=4,
                      color=theme.lines[number], linewidth=2.2)
            label = titles[agent].replace(" with ", "\nwith ").replace("factored ", "factored\n")
            write_label(axes, *place, label, theme.lines[number])
        axes.set(xscale="log", yscale="log", xlabel="buttons in the room", ylabel="primitives to the first escape",
                 ylim=(20, 1.4 * budget))
        axes.set_xticks(ticks := sorted({size for own in sizes.values() for size in own}), list(map(str, ticks)))
        axes.xaxis.set_minor_locator(NullLocator())
        mark_counts(axes.yaxis)

    return make_figure(theme, draw_axes)
