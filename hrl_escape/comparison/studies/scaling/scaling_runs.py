"""Raw results of the scaling study: one line of CSV a run, from which its page is written."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.agents.training.results import load_result
from hrl_escape.comparison.comparison import Comparison
from hrl_escape.comparison.probes.graph_recovery import compute_edge_depth, find_edges_that_matter
from hrl_escape.comparison.runs import get_training_folder
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import FileReadError
from hrl_escape.files import read_text, write_text

__all__ = ["ScalingRun", "RoomKind", "collect_scaling_runs", "join_scaling_runs", "load_scaling_runs",
           "save_scaling_runs"]


class RoomKind(NamedTuple):
    """Kind of room.

    Attributes:
        graph: family of the dependency graph.
        buttons: number of buttons.
        rule: effect of a press with unmet parents, `ignore` or `reset`; `ignore, noise` in rooms with noise and slip.
    """

    graph: str
    buttons: int
    rule: str


@dataclass(frozen=True)
class ScalingRun:
    """Result of a run.

    Attributes:
        graph: see `RoomKind`; so the next two.
        agent: name, or label where agents of one name differ.
        run: seed of room, agent and episodes.
        room: content hash of the instance.
        best: best return known for these options.
        worst: return without escape.
        budget: most primitives of training; the last option may go beyond.
        primitives: trained for.
        decisions: trained for.
        seconds: of training.
        first_escape: primitives at the end of the first training episode that escaped; None if none did.
        near_best: primitives at the first of two checks in a row near the best; None without such a pair.
        edges: number of edges that matter.
        depth: most of these in a row.
        structure: (primitives, precision, recall) at every change; empty for agents without a graph.
    """

    graph: str
    buttons: int
    rule: str
    agent: str
    run: int
    room: str
    best: float
    worst: float
    budget: int
    primitives: int
    decisions: int
    seconds: float
    first_escape: int | None
    near_best: int | None
    edges: int
    depth: int
    structure: tuple[tuple[int, float, float], ...]

    @property
    def task(self) -> RoomKind:
        """Kind of its room."""
        return RoomKind(self.graph, self.buttons, self.rule)

    @property
    def place(self) -> tuple[RoomKind, str, int]:
        """Subject of the line: another line about the same replaces it."""
        return self.task, self.agent, self.run


def collect_scaling_runs(comparison: Comparison, rooms: Mapping[RoomKind, RoomInstance]) -> list[ScalingRun]:
    """Read the finished runs of a round.

    Args:
        comparison: a round's.
        rooms: task -> its room; tasks that share a room share its run.

    Raises:
        FileReadError: a run's log is missing or damaged.
    """
    found = []
    for run, result in comparison.runs:
        training = load_result(get_training_folder(comparison.out, run))
        assert result.solution is not None, "these grids have a rule for what is solved"
        measured: dict[str, Any] = {
            "agent": run.agent.label, "run": run.seed, "room": run.place_id,
            "best": float(np.mean(result.score_range.reachable)), "worst": result.score_range.worst,
            "budget": comparison.grid.primitives, "primitives": result.primitives, "decisions": result.decisions,
            "seconds": round(training.seconds, 1), "first_escape": training.first_escape, **vars(result.solution),
        }  # fmt: skip
        found += [ScalingRun(*task, **measured, depth=_measure_depth(room)) for task, room in rooms.items()
                  if room.id == run.place_id]
    return found


def _measure_depth(room: RoomInstance) -> int:
    goals = room.puzzle.goal_targets
    return compute_edge_depth(find_edges_that_matter(room.puzzle.edges, goals), goals)


def join_scaling_runs(old: Iterable[ScalingRun], new: Iterable[ScalingRun]) -> list[ScalingRun]:
    """All runs, new ones in place of old ones about the same."""
    return list({run.place: run for run in (*old, *new)}.values())


def save_scaling_runs(path: Path, runs: Sequence[ScalingRun]) -> None:
    """Write runs as CSV, a line each; `structure` is `primitives:precision:recall;...`.

    Raises:
        FileWriteError: the file cannot be written.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    names = [field.name for field in fields(ScalingRun)]
    writer.writerow(names)
    for run in sorted(runs, key=lambda run: (*run.task, run.agent, run.run)):
        values = asdict(run)
        values["structure"] = ";".join(f"{n}:{p:g}:{r:g}" for n, p, r in run.structure)
        writer.writerow(["" if values[name] is None else values[name] for name in names])
    write_text(path, table.getvalue())


def load_scaling_runs(path: Path, agents: Collection[str]) -> list[ScalingRun]:
    """Read what `save_scaling_runs` wrote.

    Args:
        path: the file.
        agents: those of the study; others are refused.

    Raises:
        FileReadError: the file is missing or damaged, or holds no run.
    """
    found = []
    for number, row in enumerate(csv.DictReader(io.StringIO(read_text(path, "file of raw results"))), 2):
        try:
            edges, depth = int(row["edges"]), int(row["depth"])
            steps = [step.split(":") for step in row["structure"].split(";") if step]
            if row["agent"] not in agents:
                raise ValueError(f"no agent of this study is called {row['agent']!r}")
            found.append(ScalingRun(
                row["graph"], int(row["buttons"]), row["rule"], row["agent"], int(row["run"]), row["room"],
                float(row["best"]), float(row["worst"]), int(row["budget"]), int(row["primitives"]),
                int(row["decisions"]), float(row["seconds"]), int(row["first_escape"]) if row["first_escape"] else None,
                int(row["near_best"]) if row["near_best"] else None,
                edges=edges, depth=depth, structure=tuple((int(n), float(p), float(r)) for n, p, r in steps),
            ))  # fmt: skip
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise FileReadError(f"{path}, line {number}: this is no run of the scaling study ({error!r})") from error
    if not found:
        raise FileReadError(f"{path}: this file of raw results holds no run")
    return found
