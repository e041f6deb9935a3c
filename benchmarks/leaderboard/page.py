"""Page of the leaderboard, written from its result files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.leaderboard.results import Result, load
from hrl_escape.agents.spec import BAYES, REFERENCES, AgentSpec
from hrl_escape.benchmark.agent_archive import RoomView, find_rung, score_results
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.benchmark.room_intervals import compute_nested_interval
from hrl_escape.benchmark.statistics import compute_efficiency
from studies.figures import Theme, make_figure
from studies.publishing import ResultPage, Rules
from studies.study import Findings
from studies.tables import make_table

RESULTS = Path(__file__).with_name("results")
COLUMNS = ("agent", "authors", "efficiency", "minus the best search baseline", "successes", "primitives of training",
           "core hours", "actions and observation", "further information")
CUED, UNCUED = "cues-1@0/colours", "families-1@0/reset-6"


class Row(NamedTuple):
    """Row of a rung's table."""

    name: str  # of the agent
    cells: tuple[str, ...]  # further columns, as Markdown
    score: Estimate  # efficiency
    rooms: NDArray[np.float64]  # efficiency in each test room
    agent: str  # name of the package's agent or reference; empty for a program
    link: str = ""  # address of the agent


def read_rows(folder: Path) -> dict[str, list[Row]]:
    """Rows by rung, the most efficient first; results that leave out test rooms are not listed."""
    rungs: dict[str, list[Row]] = {}
    for result in map(load, sorted(folder.glob("*.json"))):
        rung = find_rung(result.card)
        if result.card.rooms == rung.record.test.count:
            rungs.setdefault(f"{rung.benchmark}/{rung.name}", []).append(
                _make_row(result, rung.config.dynamics.is_random))
    return {name: sorted(rows, key=lambda row: (-row.score.value, row.name)) for name, rows in sorted(rungs.items())}


def summarise(rungs: Mapping[str, Sequence[Row]]) -> Findings:
    """Numbers, tables and figure of the page, from the rows of each rung."""
    found: dict[str, SimpleNamespace] = {}
    for name, rows in rungs.items():
        searches = [row for row in rows if row.agent in SEARCH_BASELINES]
        search = max(searches, key=lambda row: row.score.value) if searches else None
        gains = [None if search is None or row is search else compute_nested_interval(
            [np.array([gap]) for gap in row.rooms - search.rooms]) for row in rows]
        others = [(row, gain) for row, gain in zip(rows, gains, strict=True) if row.agent not in REFERENCES]
        found[name] = SimpleNamespace(
            search=search, best=others[0][0] if others else None, gain=others[0][1] if others else None,
            bayes=next(((row, gain) for row, gain in zip(rows, gains, strict=True) if row.agent == BAYES), None),
            table=make_table(COLUMNS, [
                [f"[{row.name}]({row.link})" if row.link else row.name, row.cells[0], f"{row.score:.3f}",
                 "" if gain is None else f"{gain:+.2f}", *row.cells[1:]]
                for row, gain in zip(rows, gains, strict=True)]))
    return Findings(SimpleNamespace(rungs=found), {}, {"leaderboard": partial(draw, rungs)})


def make_page() -> ResultPage:
    """The page; `studies.publishing.publish` writes it."""
    return ResultPage("leaderboard", ("leaderboard",), RULES, Path(__file__).with_name("page.md.j2"))


def does_counting_reach_the_planner(numbers: Any) -> bool:
    """On the rung with cues an entry is above search, and within 0.02 of the Bayes planner."""
    found = numbers.leaderboard.rungs[CUED]
    return found.gain.low > 0 and found.bayes[0].score.value - found.best.score.value < 0.02


def is_the_uncued_rung_open(numbers: Any) -> bool:
    """Nobody has entered the rung without cues, where the Bayes planner is above search."""
    found = numbers.leaderboard.rungs[UNCUED]
    return found.best is None and found.bayes[1].low > 0.1


RULES: Rules = {"counting-reaches-the-planner": does_counting_reach_the_planner,
                "open-without-cues": is_the_uncued_rung_open}


def draw(rungs: Mapping[str, Sequence[Row]], theme: Theme) -> Figure:
    """Draw the efficiency of each agent on each rung, with its interval."""
    lines = [(f"{row.name}, {name}", row, theme.muted if row.agent in REFERENCES else theme.lines[0])
             for name, rows in rungs.items() for row in rows][::-1]

    def paint(axes: Axes) -> None:
        for place, (_, row, colour) in enumerate(lines):
            axes.plot([row.score.low, row.score.high], [place, place], color=colour, linewidth=1.8)
            axes.plot(row.score.value, place, "o", color=colour, markersize=5)
        axes.set_yticks(range(len(lines)), [words for words, _, _ in lines])
        axes.set(xlabel="efficiency", xlim=(0, 1.02), ylim=(-0.6, len(lines) - 0.4))

    return make_figure(theme, paint, height=1.1 + 0.28 * len(lines), grid="x")


def _make_row(result: Result, is_random: bool) -> Row:
    card, rooms = result.card, result.results
    is_spec = card.agent and card.name.startswith(card.agent)
    cells = (_escape(", ".join(card.authors)), f"{sum(each.escaped for each in rooms)} of {len(rooms)}",
             "" if card.primitives is None else f"{card.primitives:,}",
             "" if card.core_hours is None else f"{card.core_hours:.2g}", _escape(describe_view(card.view)),
             _escape(card.information))
    efficiency = compute_efficiency(*zip(*((each.escaped, each.primitives, each.fewest) for each in rooms),
                                         strict=True)).clip(max=1.0)
    return Row(_escape(AgentSpec.parse(card.name).title if is_spec else card.name), cells,
               score_results(rooms, is_random), efficiency, card.agent, card.link)


def describe_view(view: RoomView) -> str:
    """Describe actions and observation of an agent."""
    if view.choices == "primitives":
        return f"primitives, {view.observation}"
    actions = "options" + " and primitives" * view.options.include_primitives
    own = "" if view.options.option_set == "press" else f" {view.options.option_set}"
    return f"{actions}{own}, {view.observation}" + " with memory" * view.options.memory


def _escape(text: str) -> str:
    """Text as Markdown that shows it letter by letter."""
    return re.sub(r"[^\w ,.()/+:;-]|_", lambda sign: f"&#{ord(sign[0])};", text)
