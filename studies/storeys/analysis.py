"""Lessons of one floor of a tower for the next, where all floors have one order of symbols."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate_trials
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.benchmark.statistics import compute_efficiency
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.room_sequence import RoomSequence, repeat_set
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import StudyArgs as Args
from studies.store import Store
from studies.study import Page, Study
from studies.unseen import count_fewest

__all__ = ["LINES", "Args", "FloorRun", "analyse", "measure", "play_towers", "tell"]


@dataclasses.dataclass(frozen=True)
class FloorRun:
    """Episodes of one agent on one floor.

    Attributes:
        agent: name with traits.
        repeats: False where it is told nothing of the floors below.
        floor: number of the floor, from 1.
        efficiencies: of each tower.
    """

    agent: str
    repeats: bool
    floor: int
    efficiencies: tuple[float, ...]

    @property
    def place(self) -> tuple[str, bool, int]:
        """Subject of the line."""
        return self.agent, self.repeats, self.floor


LINES = (FloorRun,)


def play_towers(agent: str, tower: RoomSequence, repeats: bool, towers: int) -> list[FloorRun]:
    """Play an episode in each of the first towers; without `repeats` nothing is carried from floor to floor."""
    spec, floors = AgentSpec.parse(agent), len(tower.sets)
    order = {str(compute_episode_seed(0, "evaluation", number)): number for number in range(towers)}
    env, recorder = make_agent_env(spec, RoomSequence(tower.sets, repeats), "objects", order)
    found = evaluate_trials(make_reference(spec.name, env, recorder), env, towers, floors)
    env.close()
    runs = []
    for number, (rooms, own) in enumerate(zip(tower.sets, found, strict=True), 1):
        fewest = [count_fewest(rooms[index]) for index in range(towers)]
        values = np.minimum(compute_efficiency(own.escaped, own.lengths, fewest), 1.0)
        runs.append(FloorRun(agent, repeats, number, tuple(np.round(values, 4).tolist())))
    return runs


def measure(study: Study, args: Args, store: Store) -> None:
    """Play what is missing."""
    data = study.data
    benchmark, rung = data["rung"].split("/")
    tower = repeat_set(load_benchmark(benchmark)[rung].test, data["floors"])
    known = {run.place for run in store.load()}
    for agent, repeats in ((data["searcher"], True), (data["ceiling"], False), (data["ceiling"], True)):
        if (agent, repeats, data["floors"]) not in known:
            store.add(play_towers(agent, tower, repeats, min(data["towers"], len(tower.sets[0]))))


def _gain(first: np.ndarray, last: np.ndarray) -> tuple[float, float, float]:
    """Mean of the differences, tower by tower, with Student's interval."""
    gains = last - first
    reach = float(stats.sem(gains)) * float(stats.t.ppf(0.975, len(gains) - 1))
    return float(gains.mean()), float(gains.mean()) - reach, float(gains.mean()) + reach


def tell(floors: Sequence[np.ndarray], subject: str) -> str:
    """A sentence on whether the first floor pays on the last."""
    gain, low, high = _gain(floors[0], floors[-1])
    gained = f"{gain:+.2f}" if round(gain, 2) else "0.00"
    interval, way = f"{gained} ({low:+.2f} to {high:+.2f})", f"from floor 1 to floor {len(floors)}"
    if low > 0:
        return f"For {subject}, the first floor pays: {way} efficiency rises by {interval}."
    if high < 0:
        return f"For {subject}, efficiency falls by {interval} {way}."
    return f"For {subject}, no floor is shown to pay on another: {interval} {way}."


def analyse(study: Study, lines: Sequence[FloorRun]) -> Page:
    """Sentences, table and figure."""
    data, cells = study.data, {}
    for name, agent, repeats in (
            ("an agent that knows the room configuration and remembers the floors below", data["ceiling"], True),
            ("the same agent, forgetting each floor", data["ceiling"], False),
            ("the searcher that learns nothing", data["searcher"], True)):
        own = sorted((line for line in lines if (line.agent, line.repeats) == (agent, repeats)), key=lambda o: o.floor)
        if len(own) != data["floors"]:
            raise ComparisonError(f"{agent} was not played on every floor")
        cells[name] = [np.array(line.efficiencies) for line in own]
    sentences = [tell(floors, name) for name, floors in cells.items()]
    rows = [[name, *(f"{floor.mean():.3f}" for floor in floors)] for name, floors in cells.items()]
    head = ["", *(f"floor {number}" for number in range(1, data["floors"] + 1))]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.2, 3.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.add_subplot(xlabel="floor", ylabel="efficiency", ylim=(0, 1.03))
        for (name, floors), colour in zip(cells.items(), (palette.LINES[0], palette.MUTED, palette.LINES[1]),
                                          strict=True):
            error = [1.96 * float(stats.sem(floor)) for floor in floors]
            axes.errorbar(range(1, len(floors) + 1), [floor.mean() for floor in floors], error, fmt="o-", color=colour,
                          capsize=3, label=name)
        finish_axes(axes)
        axes.legend(loc="lower left", frameon=False)
    return Page({"headline": sentences[0], "sentences": sentences[1:], "table": make_table(head, rows),
                 "count": len(next(iter(cells.values()))[0]), **data}, {"storeys": figure}, sentences)
