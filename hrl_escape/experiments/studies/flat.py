"""Limits of flat learning as buttons grow: chains of one to six buttons, with and without exploration by counts.

Defines the agents and rooms, and writes docs/results/flat.md from the raw results.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.experiments.grid import AgentSpec, Grid
from hrl_escape.experiments.places import RoomSpec
from hrl_escape.experiments.reporting.agent_style import choose_styles
from hrl_escape.experiments.statistics import compute_final
from hrl_escape.experiments.studies.measures import Results, get_runs, measure_share_of_runs, share_of_training
from hrl_escape.experiments.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.experiments.studies.raw import RawRun
from hrl_escape.files import write_text

__all__ = ["BUTTONS", "CHAIN_AGENTS", "FLAT_AGENTS", "find_break", "make_flat_grid", "make_paper_grid",
           "write_flat_page"]

_COMMAND = "hrl-escape experiment flat"
BUTTONS = (1, 2, 3, 4, 5, 6)
LEARNED = 0.5
"""A final score from which on the goal counts as learned."""
PAPER_GRID, CHAIN_GRID = "flat-paper-room", "flat-chains"
_COUNTS: dict[str, Any] = {"bonus_weight": 10.0}
FLAT_AGENTS = (
    AgentSpec("random"),
    AgentSpec("q-learning"),
    AgentSpec("dqn"),
    AgentSpec("ppo"),
    AgentSpec("q-learning", "q-learning, counts", settings=_COUNTS),
    AgentSpec("dqn", "dqn, counts", settings=_COUNTS),
    AgentSpec("ppo", "ppo, counts", settings=_COUNTS),
)
CHAIN_AGENTS = (
    AgentSpec("random"),
    AgentSpec("dqn"),
    AgentSpec("q-learning", "q-learning, counts", settings=_COUNTS),
    AgentSpec("dqn", "dqn, counts", settings=_COUNTS),
    AgentSpec("smdp-random"),
)


def make_chain_room(buttons: int) -> RoomConfig:
    """The paper's room with buttons anywhere on the walls, each before the next, 4 m wide like the exit."""
    return RoomConfig(
        name=f"chain-{buttons}",
        room=ShapeConfig(width=20, depth=20),
        robot=RobotConfig(body_radius=0.75),
        puzzle=ButtonsConfig(count=buttons, graph=GraphConfig(kind="chain"), buttons=Panels(width=4.0)),
        start=StartConfig(place="fixed"),
        exit=ExitConfig(width=4.0, depth=4.0),
    )


def make_paper_grid(runs: int, primitives: int) -> Grid:
    """The paper's room with two buttons."""
    return Grid(name=PAPER_GRID, description="Is the paper's room with two buttons out of reach of flat learning?",
                agents=FLAT_AGENTS, rooms=(RoomSpec("paper-two-button"),), runs=runs, primitives=primitives,
                eval_episodes=1)


def make_flat_grid(runs: int, primitives: int) -> Grid:
    """Chains of one to six buttons."""
    rooms = tuple(RoomSpec(config=make_chain_room(buttons).to_dict()) for buttons in BUTTONS)
    return Grid(name=CHAIN_GRID, description="Where does flat learning break as buttons grow?",
                agents=CHAIN_AGENTS, rooms=rooms, runs=runs, primitives=primitives, eval_episodes=1)


def find_break(runs: Sequence[RawRun], buttons: Sequence[int] = BUTTONS) -> int | None:
    """The fewest buttons with which less than half of an agent's runs ever escape in training; None if none."""
    for count in buttons:
        here = [run.first_escape is not None for run in runs if run.room == f"chain-{count}"]
        if here and sum(here) < len(here) / 2:
            return count
    return None


# --- the page --------------------------------------------------------------------------------


def write_flat_page(results: Results, docs: Path) -> dict[str, int | None]:
    """Write the page and its figure; returns where each agent breaks.

    Raises:
        FileWriteError: a file cannot be written.
        ComparisonError: an agent has no runs.
    """
    breaks = {agent.label: find_break(get_runs(results, CHAIN_GRID, agent.label)) for agent in CHAIN_AGENTS}
    save_figure(docs / "figures" / "flat.svg", draw_breaks(results[CHAIN_GRID]))
    write_text(docs / "flat.md", "\n".join(_write_lines(results, breaks)))
    return breaks


def draw_breaks(runs: Sequence[RawRun]) -> Figure:
    """Runs that escape at all, and the final score, against the number of buttons."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.6, 3.2), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for number, (spec, look) in enumerate(zip(CHAIN_AGENTS, choose_styles(CHAIN_AGENTS), strict=True)):
            rooms = [[run for run in runs if run.agent == spec.label and run.room == f"chain-{n}"] for n in BUTTONS]
            ever = [100 * np.mean([run.first_escape is not None for run in room]) for room in rooms]
            final = [100 * np.mean([compute_final(run.at, run.scores, run.budget) for run in room]) for room in rooms]
            style = {"color": look.colour, "linestyle": "-" if "," in spec.label or spec.chooses_options else ":",
                     "marker": "os^v"[number % 4], "markersize": 4, "linewidth": 1.6}
            panels[0].plot(BUTTONS, ever, **style)
            panels[1].plot(BUTTONS, final, label=spec.label, **style)
        for axes, title in zip(panels, ("runs that ever escape, %", "final score, %"), strict=True):
            axes.set_title(title, fontsize=9, color=palette.INK, loc="left")
            axes.set_xlabel("buttons in a chain", color=palette.INK)
            axes.set_ylim(-4, 104)
            finish_axes(axes)
        panels[1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _write_lines(results: Results, breaks: dict[str, int | None]) -> list[str]:
    paper, chains = results[PAPER_GRID], results[CHAIN_GRID]
    runs = len({run.seed for run in paper})
    lines = [
        "# Flat learners, tried honestly", "",
        "The published program without meta-actions never updated DQN's and DDPG's weights, so that neither reached "
        "the goal with two buttons said little about flat learning. Here agents that do train try again, beside agents "
        "that explore by counts: a decision that leads to a cell of position, heading and puzzle bits for the n-th "
        f"time costs w (1 - 1 / sqrt(n)), here w = {_COUNTS['bonus_weight']:g} (`bonus_weight`, in `dqn`, "
        "`q-learning` and `ppo`).", "",
        *_tell_outcome(paper), "",
        f"## The paper's room with two buttons, {paper[0].budget:,} primitives, {_count(runs)}", "",
        "| agent | runs that ever escape (95 %) | first escape, median of those | training episodes that escape "
        "| last fifth | final score |", "|---|---|---|---|---|---|"]
    lines += [_make_row(get_runs(results, PAPER_GRID, agent)) for agent in dict.fromkeys(run.agent for run in paper)]
    seeds = len({run.seed for run in chains})
    lines += ["", f"## One to six buttons in a chain, {chains[0].budget:,} primitives, {_count(seeds)} a cell", "",
              "The same 20 x 20 m room, buttons of 4 m anywhere on the walls, each to be pressed before the next, "
              "wrong presses ignored. One button is harder here than in the paper's room, where nine strafes do. An "
              "agent breaks at the fewest buttons with which less than half of its runs ever escape.", "",
              "![Where flat learning breaks](figures/flat.svg)", "",
              "| agent | breaks at | " + " | ".join(f"{n}" for n in BUTTONS) + " |",
              "|---|---" + "|---" * len(BUTTONS) + "|"]
    for agent, broken in breaks.items():
        cells = [_make_cell([run for run in chains if run.agent == agent and run.room == f"chain-{n}"])
                 for n in BUTTONS]
        lines.append(f"| {agent} | {'not up to 6' if broken is None else broken} | " + " | ".join(cells) + " |")
    return [*lines, "", "Each cell: runs that ever escape in training; final score of frozen weights, mean, in per "
            "cent.", "", "## Make it again", "",
            "One command; finished runs are kept, and with `--from-raw` nothing is trained.", "",
            "```console", f"{_COMMAND} --runs {runs} --primitives {paper[0].budget}", "```", ""]


def _tell_outcome(paper: Sequence[RawRun]) -> list[str]:
    def list_escaping(wanted: bool) -> str:
        shares = {agent: [run.first_escape is not None for run in paper if run.agent == agent]
                  for agent in dict.fromkeys(run.agent for run in paper)}
        names = [f"{agent} ({sum(hits)} of {len(hits)} runs)" for agent, hits in shares.items() if any(hits) == wanted]
        return ", ".join(names) or "none"

    finals = {run: compute_final(run.at, run.scores, run.budget) for run in paper}
    best = max(paper, key=lambda run: finals[run])
    if not any(run.first_escape is not None for run in paper):
        outcome = "no flat agent meets the goal with two buttons"
    elif finals[best] < LEARNED:
        outcome = ("flat agents meet the goal with two buttons, but at the end the frozen weights of none go back to "
                   "it: they escape while they explore, not by what they have learned")
    else:
        outcome = "two buttons are not out of reach of flat learning"
    return [f"**In {paper[0].budget:,} primitives {outcome}.** At least once escape: {list_escaping(True)}; never: "
            f"{list_escaping(False)}. The best final score of any run is {finals[best]:.2f}, of {best.agent}. "
            f"Runs are few ({len({run.seed for run in paper})} an agent), so only large differences count."]


def _count(runs: int) -> str:
    return f"{runs} run{'s' if runs > 1 else ''}"


def _make_row(runs: Sequence[RawRun]) -> str:
    ever = measure_share_of_runs([run.first_escape is not None for run in runs]).estimate()
    first = [run.first_escape for run in runs if run.first_escape is not None]
    share = [np.mean([share_of_training(run, run.training_successes, bins) for run in runs])
             for bins in (slice(None), slice(16, None))]
    final = np.mean([compute_final(run.at, run.scores, run.budget) for run in runs])
    return (f"| {runs[0].agent} | {len(first)} of {len(runs)} ({ever.low:.0%} to {ever.high:.0%}) "
            f"| {f'{np.median(first):,.0f}' if first else 'never'} | {share[0]:.1%} | {share[1]:.1%} | {final:.3f} |")


def _make_cell(runs: Sequence[RawRun]) -> str:
    final = np.mean([compute_final(run.at, run.scores, run.budget) for run in runs])
    return f"{sum(run.first_escape is not None for run in runs)} of {len(runs)}; {final:.0%}"
