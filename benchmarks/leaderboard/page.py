"""Page of the leaderboard, written from its result files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2

from benchmarks.leaderboard.results import Result, load
from hrl_escape.agents.spec import REFERENCES, AgentSpec
from hrl_escape.benchmark.agent_archive import RoomView, find_rung, score_results
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES

RESULTS = Path(__file__).with_name("results")


class Row(NamedTuple):
    """Row of a rung's table."""

    name: str  # of the agent, as Markdown
    cells: tuple[str, ...]  # further columns, as Markdown
    score: Estimate  # efficiency in the test rooms
    agent: str  # name of the package's agent or reference; empty for a program


def write_page(folder: Path) -> str:
    """Write the Markdown page of a folder of result files; results that leave out test rooms are not listed."""
    rungs: dict[str, list[Row]] = {}
    for result in map(load, sorted(folder.glob("*.json"))):
        rung = find_rung(result.card)
        if result.card.rooms == rung.record.test.count:
            rungs.setdefault(f"{rung.benchmark}/{rung.name}", []).append(
                _make_row(result, rung.config.dynamics.is_random))
    tables = {name: sorted(rows, key=lambda row: (-row.score.value, row.name)) for name, rows in sorted(rungs.items())}
    template = jinja2.Environment(loader=jinja2.FileSystemLoader(Path(__file__).parent), trim_blocks=True,
                                  keep_trailing_newline=True).get_template("page.md.j2")
    return template.render(rungs=tables, findings={name: conclude(rows) for name, rows in tables.items()})


def conclude(rows: Sequence[Row]) -> str:
    """Compare the best agent of a rung with the best search baseline in a sentence."""
    baselines = [row for row in rows if row.agent in SEARCH_BASELINES]
    others = [row for row in rows if row.agent not in REFERENCES]
    if not baselines or not others:
        return "No comparison: a search baseline and an agent are needed."
    baseline, best = (max(some, key=lambda row: row.score.value) for some in (baselines, others))
    if best.score.low > baseline.score.value:
        return f"{best.name} is more efficient than the best search baseline."
    return f"No significant difference between the best agent, {best.name}, and the best search baseline."


def _make_row(result: Result, is_random: bool) -> Row:
    card = result.card
    score = score_results(result.results, is_random)
    is_spec = card.agent and card.name.startswith(card.agent)
    name = _escape(AgentSpec.parse(card.name).title if is_spec else card.name)
    cells = (_escape(", ".join(card.authors)), f"{score:.3f}",
             f"{sum(each.escaped for each in result.results)} of {len(result.results)}",
             "" if card.primitives is None else f"{card.primitives:,}",
             "" if card.core_hours is None else f"{card.core_hours:.2g}", _escape(describe_view(card.view)),
             _escape(card.information))
    return Row(f"[{name}]({card.link})" if card.link else name, cells, score, card.agent)


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
