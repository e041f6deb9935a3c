"""Report of a comparison: an offline HTML page, tables, figures and a Markdown summary.

This module fills `templates/report.html`. The scripts of the page draw charts and play replays from one JSON value in
it: curves, profiles, rooms and episodes. Lengths are metres and angles radians, in the room's frame.

`results.csv` and `curves.csv` are equal for two comparisons of the same grid; wall-clock times are in `timings.csv`.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import math
import re
import shlex
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from hrl_escape.agents.registry import DEFAULT_RECIPE
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.env_spec import EnvPlace
from hrl_escape.benchmark.inference import Estimate, Pair, is_better
from hrl_escape.benchmark.reporting.figures import AgentStyle, choose_styles, is_level, save_figures, select_metrics
from hrl_escape.benchmark.run_results import RunResult, get_room_file, get_training_folder, read_episodes
from hrl_escape.benchmark.statistics import compute_iqm, compute_score
from hrl_escape.benchmark.summary import AgentSummary, Curve, RoomSummary, Summary, summarise
from hrl_escape.benchmark.verdict import Sentence, find_leader, write_verdict
from hrl_escape.env.pictures.maps import make_map
from hrl_escape.env.pictures.moving_map import PLAYER, PLAYER_COLOURS, describe_room
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from hrl_escape.files import write_text
from hrl_escape.names import make_markdown_text, tell_seconds
from hrl_escape.sets.places import RunPlace
from hrl_escape.templates import embed_json, render_template

MEASURES = ("efficiency", "mean_progress", "success_rate", "mean_length")
_HEADINGS = ("efficiency", "progress", "success", "length")


def write_tables(summary: Summary, folder: Path) -> None:
    """Write `results.csv` (a row per run), `curves.csv` (a row per evaluation), `timings.csv` and `trials.csv`."""
    results, curves, timings, trials = [], [], [], []
    for run, result in summary.runs:
        head = (run.agent.label, run.room, run.place_id, run.seed)
        ends = result.score_range
        worst, top = (math.nan, math.nan) if ends is None else (ends.worst, float(np.mean(ends.best)))
        final = result.get_final("mean_return")
        results.append((*head, *map(result.get_final, MEASURES), float(compute_score(final, worst, top)), final,
                        "" if result.first_escape is None else result.first_escape, int(result.is_stuck), worst, top,
                        *_describe_reach(result), "" if (seen := result.seen_efficiency) is None else seen,
                        result.primitives, result.decisions, result.episodes,
                        result.planner_calls, run.key))
        trials += [(*head, number, efficiency, trial.success_rate, trial.mean_length) for number, (efficiency, trial)
                   in enumerate(zip(result.trial_efficiencies, result.trials, strict=True), start=1)]
        lines = [result.get_curve(measure) for measure in MEASURES]
        for evaluation, seconds, *values in zip(result.evaluations, result.seconds, *lines, strict=True):
            at = (*head, evaluation.primitives, evaluation.decisions)
            curves.append((*at, *values, float(compute_score(evaluation.mean_return, worst, top)),
                           evaluation.mean_return))
            timings.append((*head, evaluation.primitives, seconds, evaluation.seconds))
    names = ("agent", "room", "instance", "seed")
    _write(folder / "results.csv", (*names, *_HEADINGS, "return_score", "return", "first_escape", "stuck", "worst",
                                    "best", "reachable", "fewest", "fewest_reachable", "seen_efficiency",
                                    "primitives", "decisions", "episodes", "planner_calls", "key"), results)
    _write(folder / "curves.csv", (*names, "primitives", "decisions", *_HEADINGS, "return_score", "return"), curves)
    if trials:
        _write(folder / "trials.csv", (*names, "trial", "efficiency", "success", "length"), trials)
    _write(folder / "timings.csv", (*names, "primitives", "training_seconds", "evaluation_seconds"), timings)


def _describe_reach(result: RunResult) -> tuple[float, float, float | str]:
    """Return best reachable return, fewest known primitives and fewest reachable ones; empty if unknown."""
    ends = result.score_range
    if ends is None:
        return math.nan, math.nan, ""
    reach = [fewest for fewest in ends.fewest_reachable if fewest is not None]
    complete = len(reach) == len(ends.fewest_reachable)
    return float(np.mean(ends.reachable)), float(np.mean(ends.fewest)), float(np.mean(reach)) if complete else ""


def _write(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([["" if isinstance(value, float) and math.isnan(value) else value for value in row]
                      for row in rows])
    write_text(path, text.getvalue())


def write_markdown(summary: Summary, verdict: Sequence[Sentence], command: str, path: Path) -> None:
    """Write the verdict and the table of results as Markdown; names and labels from files are shown as they are."""
    grid = summary.grid
    said = [(sentence.kind, make_markdown_text(sentence.text)) for sentence in verdict]
    lines = [f"# {make_markdown_text(grid.name)}", "", f"**{said[0][1]}**", ""]
    lines += [f"- {text}" for kind, text in said[1:] if kind == "finding"]
    lines += ["", *(_make_room_table(summary) if grid.env is None else _make_env_table(summary))]
    cautions = [f"- {text}" for kind, text in said if kind == "caution"]
    lines += ["", *(["Read with care:", "", *cautions, ""] if cautions else [])]
    if grid.env is None:
        lines.append("Rooms: " + "; ".join(
            f"{make_markdown_text(room.name)}, {describe_place(room.place)}, best known escape {room.fewest:g} "
            f"primitives, return {room.best:g}" for room in summary.rooms) + ".")
    shown = "".join(letter if letter.isprintable() else " " for letter in command)
    fence = max(re.findall("`{3,}", shown), key=len, default="``") + "`"  # longer than any in the command
    lines += ["", f"{fence}console", shown, fence, ""]
    write_text(path, "\n".join(lines))


def _make_room_table(summary: Summary) -> list[str]:
    count, are_sets, grid = len(summary.rooms), bool(summary.grid.train_rooms), summary.grid
    one, many = ("set of rooms", "sets of rooms") if are_sets else ("room", "rooms")
    rooms = f"each of {count} {many}" if count > 1 else f"one {one}"
    unseen = summary.covers_unseen
    seen = "| in unseen rooms (mean, two-way 95 % interval) " * unseen + "| in rooms trained in " * are_sets
    return [f"After {grid.primitives:,} primitives, {grid.runs} runs in {rooms}. Efficiency is "
            f"0 without escape, else the fewest primitives known over those taken. {summary.describe_intervals()}", "",
            f"| agent | efficiency (IQM, 95 % interval) {seen}| progress | success rate (Wilson) "
            "| primitives an episode | first escape | return score | stuck runs | missing: options + learning |",
            "|---|---|---|---|---|---|---|---|---|" + "---|" * (are_sets + unseen),
            *(_make_line(agent, are_sets, unseen) for agent in summary.agents)]


def _make_env_table(summary: Summary) -> list[str]:
    grid, columns = summary.grid, list_env_columns(summary)
    return [f"After {grid.primitives:,} primitives in {make_markdown_text(summary.rooms[0].name)}, {grid.runs} runs. "
            f"Returns are means over the last fifth of training. {summary.describe_intervals()}", "",
            f"| agent | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|",
            *(f"| {make_markdown_text(agent.label)} | {' | '.join(list_env_values(summary, agent))} |"
              for agent in summary.agents)]


def list_env_columns(summary: Summary) -> list[str]:
    """Return the headings of the results in an environment from elsewhere."""
    success = ["success rate (95 % interval)", "first success"] if summary.reports_success else []
    return ["return (mean, 95 % t interval)", *success, "primitives an episode", "decisions"]


def list_env_values(summary: Summary, agent: AgentSummary) -> list[str]:
    """Return the results of an agent under the headings of `list_env_columns`."""
    success = [f"{agent.success:.0%}", format_first_escape(agent)] if summary.reports_success else []
    return [f"{agent.returns:.4g}", *success, f"{agent.length.value:,.0f}", f"{agent.decisions:,.0f}"]


def _make_line(agent: AgentSummary, are_sets: bool, covers_unseen: bool) -> str:
    unseen = f"{agent.unseen:.3f} | " if covers_unseen else ""
    seen = "- | " if agent.seen is None else f"{agent.seen:.3f} | "
    return (f"| {make_markdown_text(agent.label)} | {agent.efficiency:.3f} "
            f"| {unseen}{seen * are_sets}{agent.progress.value:.2f} | {agent.success:.0%} | {agent.length.value:.0f} "
            f"| {format_first_escape(agent)} "
            f"| {agent.score.value:.3f} | {agent.stuck:.0%} | {agent.gap.options:.3f} + {agent.gap.learning:.3f} |")


def describe_place(place: RunPlace | EnvPlace) -> str:
    """Describe a room by its id, a split by numbers of rooms and overlaps with training, an environment by its text."""
    if isinstance(place, EnvPlace):
        return f"`{place.spec.env}`" + (f" with the options `{place.spec.options}`" if place.spec.options else "")
    if place.split is None:
        return f"instance `{place.id}`"
    split = place.split
    return (f"{len(split.train)} rooms to train in, {len(split.test)} to be tested in, where {split.room_overlap:.0%} "
            f"of the rooms and {split.task_overlap:.0%} of the tasks are trained in too")


def format_first_escape(agent: AgentSummary) -> str:
    """Format the restricted mean of primitives to the first escape, as `1,234 (8 of 8)`, or `no training`."""
    if not agent.is_trained:
        return "no training"
    return f"{agent.first_escape.value:,.0f} ({agent.escaped_runs} of {agent.runs})"


PAGE = "report.html"
SCRIPTS = ("chart.js", "moving_map.js", "page.js")
BETTER, EVEN, WORSE = (0, 114, 178), (120, 110, 90), (213, 94, 0)
"""Tints of the odds: blue above one half, orange below."""


def write_report(comparison: Comparison, command: str, folder: Path | None = None) -> Summary:
    """Write `report.html`, `summary.md`, `results.csv`, `curves.csv`, `timings.csv` and `figures/`.

    Args:
        comparison: the comparison.
        command: command or call that reproduces it.
        folder: folder of the files; by default the comparison's.

    Returns:
        The summary.

    Raises:
        ComparisonError: no run has finished.
        FileWriteError: a file cannot be written.
        FileReadError: a record of episodes is missing or damaged.
    """
    summary = summarise(comparison)
    folder = comparison.out if folder is None else folder
    write_tables(summary, folder)
    write_markdown(summary, write_verdict(summary), command, folder / "summary.md")
    save_figures(summary, folder / "figures")
    write_text(folder / PAGE, make_page(comparison, summary, command))
    return summary


class _Entry(NamedTuple):
    """An agent on the page."""

    agent: AgentSummary
    look: AgentStyle
    chip: Markup  # its label, in its colours


def make_page(comparison: Comparison, summary: Summary, command: str) -> str:
    """Return the page as HTML."""
    looks = choose_styles([agent.spec for agent in summary.agents])
    entries = [_Entry(agent, look, _make_chip(agent, look)) for agent, look in zip(summary.agents, looks, strict=True)]
    chips = {entry.agent.label: entry.chip for entry in entries}
    verdict = [(sentence.kind, _mark_agents(sentence.text, chips)) for sentence in write_verdict(summary)]
    replays = choose_replays(comparison)
    leader = find_leader(summary.agents)
    hero = next((number for number, replay in enumerate(replays)
                 if replay["agent"] == leader.label and MEDIAN in replay["kinds"]), None)
    return render_template(
        "hrl_escape.benchmark.reporting", PAGE,
        grid=summary.grid,
        summary=summary,
        css=_read("report.css", "moving_map.css"),
        script=_read(*SCRIPTS),
        data=embed_json(make_page_data(summary, entries, replays)),
        headline=verdict[0][1],
        findings=[text for kind, text in verdict if kind == "finding"],
        cautions=[text for kind, text in verdict if kind == "caution"],
        hero="" if hero is None else hero,
        replay=None if hero is None else replays[hero],
        viewings=[] if hero is None or leader.spec.is_reference else _list_viewings(comparison, replays[hero]),
        leader_chip=chips[leader.label],
        entries=entries,
        leader=leader,
        in_rooms=summary.grid.env is None,
        metrics=list_page_metrics(summary),
        env_columns=list_env_columns(summary), env_values={entry.agent.label: list_env_values(summary, entry.agent)
                                                           for entry in entries},
        by_room=[(entry.chip, _list_room_cells(summary, entry.agent)) for entry in entries],
        odds=[(entry, _list_odds_cells(summary, number)) for number, entry in enumerate(entries)],
        rooms=[_describe_room(room, number, entries) for number, room in enumerate(summary.rooms)
               if summary.grid.env is None],
        failures=comparison.failures,
        command=command,
        training_seconds=sum(agent.seconds * agent.runs for agent in summary.agents),
        describe_kind=describe_kind, describe_place=describe_place, format_first_escape=format_first_escape,
        place_bar=_place_bar, tell_seconds=tell_seconds, to_json=json.dumps,
    )


def _read(*names: str) -> Markup:
    """Scripts or styles of the page, and of the player in it, one after another."""
    own = files("hrl_escape.benchmark.reporting") / "templates"
    return Markup("\n".join(((PLAYER if name.startswith("moving_map") else own) / name).read_text(encoding="utf-8")
                            for name in names))


# --- agents in words -------------------------------------------------------------------


def _make_chip(agent: AgentSummary, look: AgentStyle) -> Markup:
    style = f"--line:{look.colour};--text:{look.text}"
    view = "flat" if look.is_dashed else "options"
    chip = Markup('<span class="agent {}" style="{}" title="{}">{}</span>')
    return chip.format(view, style, agent.label, agent.spec.title)


def _mark_agents(text: str, chips: dict[str, Markup]) -> Markup:
    """Escape a sentence and replace labels between backticks by chips."""
    parts = re.split(r"`([^`]*)`", text)
    return Markup("").join(
        chips.get(part, Markup("<code>{}</code>").format(part)) if number % 2 else escape(part)
        for number, part in enumerate(parts)
    )


def _list_viewings(comparison: Comparison, replay: dict[str, Any]) -> list[str]:
    """Return the commands that show the run of a replay in 3D, live and as an offline page."""
    place = comparison.places[replay["room"]]
    assert isinstance(place, RunPlace), "only episodes of rooms are recorded"
    run = next(run for run, _ in comparison.runs if (run.agent.label, run.place_id, run.seed)
               == (replay["agent"], place.id, replay["seed"]))
    arguments = shlex.join([str(get_training_folder(comparison.out, run)),
                            "--room", str(get_room_file(comparison.out, place.instance.id))])
    option_set = run.agent.options.option_set
    arguments += f" --option-set {option_set}" if run.agent.chooses_options and option_set != "press" else ""
    return [f"hrl-escape watch {arguments}", f"hrl-escape record {arguments} --out escape.html"]


def describe_kind(spec: AgentSpec) -> str:
    """Describe the actions of an agent, such as `options only, with ancestors`."""
    if spec.low_level is not None:
        actions = f"synthesised hierarchy, {spec.low_level} low level; privileged: {', '.join(spec.privileges)}"
    elif not spec.chooses_options:
        actions = "primitives only"
    else:
        actions = "options and primitives" if spec.options.include_primitives else "options only"
        actions += ", with ancestors" if spec.options.option_set == "press-with-ancestors" else ""
    fixed = "trained before, " if spec.is_frozen else "reference, "
    kind = fixed if spec.is_reference else "" if spec.learns else "random policy, "
    return kind + actions + (f", settings {spec.recipe}" if spec.recipe != DEFAULT_RECIPE else "")


# --- tables ----------------------------------------------------------------------------


def _place_bar(estimate: Estimate) -> str:
    """Return the style of an interval's bar on a scale from 0 to 1."""
    low, high = (100 * min(max(end, 0.0), 1.0) for end in (estimate.low, estimate.high))
    return f"left:{min(low, 99):.2f}%;width:{max(high - low, 0):.2f}%"


class _Cell(NamedTuple):
    """Make a table cell coloured by its number."""

    text: str
    style: str = ""
    title: str = ""


def _list_room_cells(summary: Summary, agent: AgentSummary) -> list[_Cell]:
    """Make the cells of an agent's efficiency in each room."""
    cells = []
    for room, scores in zip(summary.rooms, agent.efficiencies, strict=True):
        if not len(scores):
            cells.append(_Cell("-", title=f"{agent.label} has no result in {room.name}"))
            continue
        score = float(compute_iqm([scores]))
        runs = ", ".join(f"{value:.3f}" for value in sorted(scores))
        tint = _tint(BETTER, min(max(score, 0), 1))
        cells.append(_Cell(f"{score:.3f}", tint, f"{agent.label} in {room.name}: {runs}"))
    return cells


def _list_odds_cells(summary: Summary, number: int) -> list[_Cell]:
    """Make the cells of the shares of pairs with an agent above each other agent."""
    first = summary.agents[number]
    name = summary.measure.name
    return [_Cell("") if first is second else _make_odds_cell(first, second, pair, name)
            for second, pair in zip(summary.agents, summary.pairs[number], strict=True)]


def _make_odds_cell(first: AgentSummary, second: AgentSummary, pair: Pair, name: str) -> _Cell:
    odds, gain = pair.improvement, pair.difference.value
    tint = _tint(BETTER if odds.value > 0.5 else WORSE if odds.value < 0.5 else EVEN, abs(odds.value - 0.5) * 2)
    is_clear = is_better(pair) or is_better(pair.turn())
    return _Cell(f"{odds.value:.2f}", tint + (";font-weight:700" if is_clear else ""),
                 f"{first.label} above {second.label} in {odds.value:.3f} of {pair.count} pairs; difference of "
                 f"{name} {gain:+.3g}, corrected p {pair.p:.3g}")


def _tint(colour: tuple[int, int, int], strength: float) -> str:
    red, green, blue = colour
    return f"background:rgba({red},{green},{blue},{0.05 + 0.3 * strength:.2f})"


# --- rooms -----------------------------------------------------------------------------


def _describe_room(room: RoomSummary, number: int, entries: Sequence[_Entry]) -> dict[str, Any]:
    instance = room.instance
    scores = [(float(compute_iqm([entry.agent.efficiencies[number]])), entry) for entry in entries
              if len(entry.agent.efficiencies[number])]
    puzzle = instance.puzzle
    edges = [f"{puzzle.target_names[a]} before {puzzle.target_names[b]}" for a, b in get_mixin(puzzle, Graphed).edges]
    words = [f"{2 * instance.half_width:.3g} \N{MULTIPLICATION SIGN} {2 * instance.half_depth:.3g} m"]
    words += [", ".join(edges)] if 0 < len(edges) <= 6 else []
    split = "" if room.place.split is None else f" One of the rooms tested in: {describe_place(room.place)}."
    ends = ("" if np.isnan(room.best) else
            f" The best known escape takes {room.fewest:g} primitives ({room.source}).")
    return {
        "name": room.name,
        "id": instance.id,
        "words": f"{'; '.join(words)}.{ends}{split}",
        "picture": _embed_picture(instance),
        "ranks": sorted(scores, key=lambda row: -row[0]),
    }


def _embed_picture(instance: Any) -> str:
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "hrl-escape", "svg.fonttype": "path"}):
        make_map(instance).savefig(content, format="svg", metadata={"Date": None}, bbox_inches="tight", pad_inches=0.05)
    return f"data:image/svg+xml;base64,{base64.b64encode(content.getvalue()).decode()}"


# --- the data inside the page ---------------------------------------------------------------

BEST, MEDIAN = "best", "median"


def make_page_data(summary: Summary, entries: Sequence[_Entry], replays: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Collect what the page's scripts need."""
    rooms = [describe_room(room.instance) for room in summary.rooms] if summary.grid.env is None else []
    for replay in replays:
        room, primitives = rooms[replay["room"]], summary.rooms[replay["room"]].instance.robot.actions.names
        chosen = {name for name, _, _ in replay["decisions"]}.difference(primitives)
        room["options"] = sorted(chosen.union(room["options"]))
    return {
        "agents": [_describe_agent(entry.agent, entry.look) for entry in entries],
        "thresholds": summary.thresholds.tolist(),
        "measure": summary.measure.name,
        "has_rooms": summary.grid.env is None,
        "rooms": rooms,
        "replays": list(replays),
        "looks": PLAYER_COLOURS,
    }


def choose_replays(comparison: Comparison) -> list[dict[str, Any]]:
    """Return the best and the median final episode of each agent in each room, over all runs.

    Episodes have the form of `record_episode`, with `agent`, `room` (index), `seed`, `episode` and `kinds`: `best`,
    `median` or both. The median of an even number is the better of the middle two.
    """
    chosen = []
    for number, spec in enumerate(comparison.grid.agents):
        for room, place in enumerate(comparison.places):
            runs = [run for run, _ in comparison.runs if run.number == number and run.place_id == place.id]
            episodes = [
                {"agent": spec.label, "room": room, "seed": run.seed, "episode": index, **episode}
                for run in runs for index, episode in enumerate(read_episodes(comparison.out, run))
            ]
            if not episodes:
                continue
            episodes.sort(key=lambda episode: -episode["return"])  # stable: equal episodes keep the order of seeds
            best, median = episodes[0], episodes[(len(episodes) - 1) // 2]
            if best["return"] == median["return"]:
                chosen.append({**best, "kinds": [BEST, MEDIAN]})
            else:
                chosen += [{**best, "kinds": [BEST]}, {**median, "kinds": [MEDIAN]}]
    return chosen


PAGE_METRICS = {"efficiency": "efficiency", "gap": "gap to best", "progress": "progress", "success": "success rate",
                "length": "primitives an episode", "score": "return score"}
"""Metrics of the page's learning curves in rooms, with the words on their buttons."""


def list_page_metrics(summary: Summary) -> dict[str, str]:
    """Return the metrics of the page's learning curves, the first one drawn at first."""
    if summary.grid.env is None:
        return PAGE_METRICS
    return select_metrics(summary, {"return": "return", **PAGE_METRICS})


def _describe_agent(agent: AgentSummary, look: AgentStyle) -> dict[str, Any]:
    return {
        "label": agent.label,
        "title": agent.spec.title,
        "colour": look.colour,
        "text": look.text,
        "dash": look.is_dashed,
        "is_level": is_level(agent),
        "curve": _describe_curve(agent.curve),
        "room_curves": [None if curve is None else _describe_curve(curve) for curve in agent.room_curves],
        "profile": _round(agent.profile),
    }


def _describe_curve(curve: Curve) -> dict[str, Any]:
    return {
        "primitives": _round(curve.primitives),
        "decisions": _round(curve.decisions),
        "seconds": _round(curve.seconds),
        **{name: [_round(line) for line in lines] for name, lines in curve.metrics.items()},
    }


def _round(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.5g}") for value in values]
