"""Comparison of agents in one call, in rooms or in any Gymnasium environment."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium
from rich.console import Console

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.env_spec import EnvSpec
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.reporting.figures import choose_styles, draw_styled
from hrl_escape.benchmark.reporting.report import PAGE, format_first_escape, write_report
from hrl_escape.benchmark.summary import AgentSummary, Summary, summarise
from hrl_escape.benchmark.verdict import Verdict, write_verdict
from hrl_escape.errors import GridError
from hrl_escape.figures import make_svg
from hrl_escape.notebook import mark_labels
from hrl_escape.sets.room_spec import RoomSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def compare(
    agents: Sequence[str | AgentSpec | type[Agent] | Agent],
    *,
    env: str | Callable[..., gymnasium.Env] | None = None,
    options: Any = None,
    room: str | Sequence[str] | None = None,
    train_rooms: str | Sequence[str] = (),
    test_rooms: str | Sequence[str] = (),
    seeds: int = 10,
    primitives: int = 20_000,
    eval_every: int | None = None,
    eval_episodes: int = 5,
    observation: str | None = None,
    score: Literal["auto", "return", "success"] = "auto",
    reference: float | None = None,
    name: str = "comparison",
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> CompareResult:
    """Train and evaluate agents on the same task with the same seeds, and compare them.

    Runs are processes, so a script needs `if __name__ == "__main__":` around the call. Functions and classes of a
    script or a notebook, lambdas included, are sent to them by `cloudpickle`.

    Args:
        agents: specs such as `dqn` and `smdp-dqn`, classes derived from `Agent`, `SB3Agent(...)` or `FrozenAgent(...)`.
        env: Gymnasium id; a function that makes an environment; or `file.py:function`. It must not be given with rooms.
        options: for agents that choose among options in `env`: a function from the environment to its options, the
            options, or `file.py:function`. Agents that act with primitives get the environment without them.
        room: rooms, such as `clutter#3` or `ladder-1/chain/test#0`; each is for training and evaluation.
        train_rooms: sets of training rooms, such as `ladder-1/chain/train`.
        test_rooms: sets of test rooms, one for all `train_rooms` or one for each.
        seeds: training seeds of each agent; all agents have the same. From ten the result has a verdict with corrected
            tests, below it estimates and intervals.
        primitives: training budget of a run.
        eval_every: primitives between evaluations; a twentieth of the budget by default.
        eval_episodes: episodes in an evaluation, the same for all agents.
        observation: observation of rooms; by default `features`, or `objects` if an agent needs it.
        score: number that agents are compared by in `env`: `return`, `success` (`info["is_success"]`), or `auto`, which
            takes the success rate where every episode reports it. In rooms it is the efficiency.
        reference: return to draw and to name for comparison in `env`.
        name: name of the comparison.
        out: folder of the runs. The same call continues there, and finished runs are kept, also those of fewer seeds.
            By default a temporary folder.
        workers: runs at a time; one a core by default.
        progress: print a line for each finished run.

    Returns:
        Verdict, curves and table, which notebooks display. `report(folder)` writes the page.

    Raises:
        GridError: the agents or the task are not possible.
        ComparisonError: no run has finished.
        EscapeError: no such agent, setting or room; the folder cannot be written or is in use.
    """
    specs = tuple(map(AgentSpec.parse, agents))
    if observation is None:
        observation = "objects" if any(spec.reads_objects for spec in specs) else "features"
    where: dict[str, Any] = {}
    if env is not None:
        if room is not None or train_rooms or test_rooms:
            raise GridError("env is given together with rooms: give one of them")
        where["env"] = EnvSpec.make(env, options, score=score, reference=reference)
    elif options is not None or score != "auto" or reference is not None:
        raise GridError("options, score and reference are for env=; the options of rooms are part of an agent's spec, "
                        "such as smdp-dqn+reactive")
    elif train_rooms or test_rooms:
        if room is not None:
            raise GridError("room is given together with train_rooms: give one of them")
        where |= {"rooms": (), "train_rooms": _list_texts(train_rooms), "test_rooms": _list_texts(test_rooms)}
    elif room is not None:
        where["rooms"] = tuple(map(RoomSpec.parse, _list_texts(room)))
    else:
        raise GridError("a task is missing: give env='CartPole-v1', or room='clutter'")
    grid = Grid(name, agents=specs, runs=seeds, primitives=primitives, eval_every=eval_every,
                eval_episodes=eval_episodes, observation=observation, **where)
    temporary = tempfile.TemporaryDirectory(prefix="hrl-escape-") if out is None else None
    console = Console(stderr=True, highlight=False, quiet=not progress)
    comparison = run_grid(grid, temporary.name if temporary is not None else os.fspath(out or ""),
                          LocalLauncher(workers), console, progress=None if progress else False)
    return CompareResult(comparison, summarise(comparison), format_call(grid), temporary)


def _list_texts(texts: str | Sequence[str]) -> tuple[str, ...]:
    return (texts,) if isinstance(texts, str) else tuple(texts)


def format_call(grid: Grid) -> str:
    """Return the Python call of a grid's comparison."""
    given = [f"[{', '.join(repr(agent.label) for agent in grid.agents)}]"]
    if grid.env is not None:
        fields = {"env": grid.env.env, "options": grid.env.options or None, "reference": grid.env.reference}
    else:
        fields = {"room": [room.label for room in grid.rooms] or None, "train_rooms": list(grid.train_rooms) or None,
                  "test_rooms": list(grid.test_rooms) or None}
    fields |= {"seeds": grid.runs, "primitives": grid.primitives, "eval_every": grid.eval_every,
               "eval_episodes": grid.eval_episodes}
    given += [f"{name}={value!r}" for name, value in fields.items() if value is not None]
    return f"compare({', '.join(given)})"


@dataclass(frozen=True, repr=False)
class CompareResult:
    """Result of `compare`; notebooks display verdict, learning curves and table."""

    comparison: Comparison  # runs and their folder
    summary: Summary  # numbers
    call: str  # Python call of the comparison
    _folder: Any = dataclasses.field(default=None, repr=False)  # keeps a temporary folder

    def __repr__(self) -> str:
        headline = self.verdict[0].text.replace("`", "")
        return f"<CompareResult of {len(self.summary.agents)} agents, {len(self.summary.runs)} runs: {headline}>"

    @cached_property
    def verdict(self) -> Verdict:
        """Sentences: a headline, findings and cautions."""
        return write_verdict(self.summary)

    def plot(self, metric: str | None = None, against: str = "primitives") -> Figure:
        """Draw learning curves with 95 % bands over seeds.

        Args:
            metric: `efficiency`, `success` or `score` in rooms; `return`, `success` or `length` in an environment; by
                default the number that agents are compared by.
            against: `primitives`, `decisions` or `seconds` of training.

        Returns:
            A matplotlib figure without a window.
        """
        return draw_styled(self.summary, metric or self.summary.measure.curve, against)

    def report(self, folder: str | os.PathLike[str]) -> Path:
        """Write the report: page, summary, tables and figures.

        Args:
            folder: folder of the files.

        Returns:
            Path of the page.
        """
        write_report(self.comparison, self.call, Path(folder))
        return Path(folder) / PAGE

    def _repr_html_(self) -> str:
        headline, *others = self.verdict
        findings, cautions = ("".join(f"<li>{mark_labels(each.text)}</li>" for each in others if each.kind == kind)
                              for kind in ("finding", "caution"))
        care = f"<details><summary>Read with care</summary><ul>{cautions}</ul></details>" if cautions else ""
        return (f"<p><b>{mark_labels(headline.text)}</b></p><ul>{findings}</ul>{make_svg(self.plot())}"
                f"{self._make_table()}<p>{escape(self.summary.describe_intervals())}</p>{care}")

    def _make_table(self) -> str:
        measure = self.summary.measure
        headings = ["agent", f"{measure.name} ({measure.interval})", "success rate", "primitives an episode",
                    "decisions", "first success"]
        if self.summary.covers_unseen:
            headings.insert(2, "in unseen rooms (mean, two-way 95 % interval)")
        looks = choose_styles([agent.spec for agent in self.summary.agents])
        rows = "".join(
            f'<tr><th style="text-align:left;color:{look.text}">{escape(agent.label)}</th>'
            + "".join(f"<td>{value}</td>" for value in self._list_values(agent)) + "</tr>"
            for agent, look in zip(self.summary.agents, looks, strict=True))
        head = "".join(f"<th>{heading}</th>" for heading in headings)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"

    def _list_values(self, agent: AgentSummary) -> list[str]:
        reports = self.summary.reports_success
        unseen = [f"{agent.unseen:.2f}"] if self.summary.covers_unseen else []
        return [self.summary.measure.describe(agent.primary), *unseen, f"{agent.success.value:.0%}" if reports else "-",
                f"{agent.length.value:,.0f}", f"{agent.decisions:,.0f}",
                format_first_escape(agent) if reports else "-"]
