"""Writes the gallery's page from its findings: a table of all puzzles, then each with picture, rules and exactness."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

from hrl_escape.comparison.baselines.lines import LEAST_RUNS
from hrl_escape.comparison.gallery.entries import EXACTNESS, Entry, load_entries
from hrl_escape.comparison.gallery.measure import LEARNER, PLAYERS, PlayedRun, SolvedRoom
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words

__all__ = ["GALLERY_PAGE", "write_gallery"]

GALLERY_PAGE = "gallery.md"
_COMMAND = "hrl-escape experiment gallery"


def write_gallery(found: Iterable[SolvedRoom | PlayedRun], docs: Path) -> None:
    """Write the page.

    Args:
        found: findings of at least one puzzle of the gallery.
        docs: folder of the page.

    Raises:
        FileWriteError: the page cannot be written.
    """
    found = list(found)
    rooms = {each.preset: each for each in found if isinstance(each, SolvedRoom)}
    runs = [each for each in found if isinstance(each, PlayedRun)]
    shown = [entry for entry in load_entries() if entry.preset in rooms]
    text = ["# Gallery of puzzles", "", _introduce(runs), "", *_summarise(shown, runs), ""]
    text += _tabulate(shown, rooms, runs)
    for level, meaning in EXACTNESS.items():
        text += ["", f"- **{level}**: {meaning}."] if level == "L1" else [f"- **{level}**: {meaning}."]
    for entry in shown:
        text += ["", *_describe(entry, rooms[entry.preset])]
    learned = [run for run in runs if run.agent == LEARNER]
    text += ["", "```console", f"{_COMMAND} --runs {1 + max((run.seed for run in learned), default=0)} "
             f"--primitives {max((run.primitives for run in learned), default=0)} --episodes {_count_episodes(runs)}",
             "```", "", "Every finding is a line of `raw/gallery.jsonl`.", ""]
    write_text(docs / GALLERY_PAGE, "\n".join(text))


def _count_episodes(runs: Sequence[PlayedRun]) -> int:
    return max((len(run.escapes) for run in runs), default=0)


def _introduce(runs: Sequence[PlayedRun]) -> str:
    learned = [run for run in runs if run.agent == LEARNER]
    seeds, budget = len({run.seed for run in learned}), max((run.primitives for run in learned), default=0)
    few = "few runs, " if seeds < LEAST_RUNS else ""
    return ("One room of each puzzle, solved by the planner and played by three agents that choose among options: at "
            f"random, in the order of the numbers, and learning (`{LEARNER}`). These are {few}"
            f"{count_nouns(seeds, 'training seed')} of {budget:,} primitives and {_count_episodes(runs)} evaluation "
            "episodes each: they tell what is easy, and rank no agents. [The puzzle zoo](../puzzles.md) has sources "
            "and proofs.")


def _summarise(shown: Sequence[Entry], runs: Sequence[PlayedRun]) -> list[str]:
    """Say by rule which puzzles need no learning, and which were not learned."""
    always = {agent: [entry.name for entry in shown
                      if (share := _measure_share(runs, entry.preset, agent)) is not None and share == 1.0]
              for agent in PLAYERS}
    never = [entry.name for entry in shown if _measure_share(runs, entry.preset, LEARNER) == 0.0]
    names = ("Random options escape", "Options in the order of their numbers escape", f"`{LEARNER}` escapes")
    lines = [f"- {name} in every episode of {join_words(titles) or 'no puzzle'}."
             for name, titles in zip(names, always.values(), strict=True)]
    return [*lines, *([f"- `{LEARNER}` escapes in no episode of {join_words(never)}."] if never else [])]


def _select(runs: Sequence[PlayedRun], preset: str, agent: str) -> list[int | None]:
    return [length for run in runs if (run.preset, run.agent) == (preset, agent) for length in run.escapes]


def _measure_share(runs: Sequence[PlayedRun], preset: str, agent: str) -> float | None:
    """Share of the episodes that escaped; None without any."""
    lengths = _select(runs, preset, agent)
    return sum(length is not None for length in lengths) / len(lengths) if lengths else None


def _tabulate(shown: Sequence[Entry], rooms: dict[str, SolvedRoom], runs: Sequence[PlayedRun]) -> list[str]:
    """One row a puzzle: level, fewest operators, the planner's primitives; escapes and their median primitives."""
    rows = ["| puzzle | exact | fewest operators | planner | random | in order | learning |",
            "|---|---|---|---|---|---|---|"]
    for entry in shown:
        room = rooms[entry.preset]
        cells = [f"`{entry.preset}`", entry.level, str(room.fewest), str(room.planned or ""),
                 *(_write_escapes(_select(runs, entry.preset, agent)) for agent in PLAYERS)]
        rows.append(f"| {' | '.join(cells)} |")
    return [*rows, "", "The planner's column counts the primitives of its escape from the first start, which supposes "
            "likely outcomes; the agents' columns give the share of episodes that escape, and the median of their "
            "primitives, from starts that are drawn. Nothing is learned under physics, where a run takes minutes."]


def _write_escapes(lengths: Sequence[int | None]) -> str:
    escaped = [length for length in lengths if length is not None]
    if not lengths:
        return ""
    share = f"{len(escaped) / len(lengths):.0%}"
    return f"{share}, {statistics.median(escaped):.0f}" if escaped else share


def _describe(entry: Entry, room: SolvedRoom) -> list[str]:
    optimum = entry.optimum.format(fewest=room.fewest, expected=f"{room.fewest / room.success:.1f}")
    return [f"## {entry.title}", "", f"```{{room}} --preset {entry.preset}", "```", "", entry.rules, "",
            f"- Exactness: {entry.level}.", f"- Carries over: {entry.carries}.",
            f"- Does not carry over: {entry.carries_not}.", f"- Optimum: {optimum}."]
