"""Baselines as data: one line of JSON a run, small enough to come with the documentation.

Lines of other machines are joined; a run that was made again takes the place of its old line.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from hrl_escape.comparison.comparison import Comparison
from hrl_escape.comparison.statistics import LEAST_RUNS, compute_iqm
from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_text, write_text
from hrl_escape.processes import taking_turns
from hrl_escape.settings import read_record

__all__ = ["LEAST_RUNS", "BaselineRun", "collect_baselines", "compute_run_efficiency", "join_lines",
           "joining_lines", "load_data_lines", "load_lines", "save_lines"]


class DataLine(Protocol):
    """Dataclass of which each instance is a line of a file."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def place(self) -> Any:
        """Subject of the line, by which lines are sorted."""
        ...


DataLineT = TypeVar("DataLineT", bound=DataLine)


@dataclass(frozen=True)
class BaselineRun:
    """Result of one run of a rung.

    Attributes:
        protocol: such as `per-instance`.
        rung: name.
        rooms: room, or sets of rooms, in short text.
        agent: label.
        seed: of training.
        primitives: training budget; 0 for agents that learn nothing.
        efficiency: in the last fifth of training.
        seen: the same in rooms trained in; None where they are those tested in.
        escapes: share of the evaluation episodes of the last fifth that escaped.
        episodes: in an evaluation.
        progress: mean share of the facts on the way to the goal that hold.
        first_escape: primitives to the first escape in training; None if there was none.
        key: hash of everything that decides the run's numbers.
    """

    protocol: str
    rung: str
    rooms: str
    agent: str
    seed: int
    primitives: int
    efficiency: float
    seen: float | None
    escapes: float
    episodes: int
    progress: float
    first_escape: int | None
    key: str

    @property
    def place(self) -> tuple[str, str, str, str, int, int]:
        """Subject of the line: another line about the same replaces it."""
        return self.protocol, self.rung, self.rooms, self.agent, self.seed, self.primitives


def collect_baselines(comparison: Comparison, protocol: str, rung: str) -> list[BaselineRun]:
    """Lines of the finished runs of a rung under a protocol."""
    return [BaselineRun(
        protocol=protocol, rung=rung, rooms=run.room, agent=run.agent.label, seed=run.seed,
        primitives=run.grid.primitives if run.agent.learns else 0,
        efficiency=round(result.get_final("efficiency"), 4),
        seen=None if result.seen_efficiency is None else round(result.seen_efficiency, 4),
        escapes=round(result.get_final("success_rate"), 4), episodes=run.grid.eval_episodes,
        progress=round(result.get_final("mean_progress"), 4),
        first_escape=result.first_escape if run.agent.learns else None, key=run.key,
    ) for run, result in comparison.runs]


def compute_run_efficiency(runs: Sequence[BaselineRun]) -> float:
    """Interquartile mean over runs; of fewer than four the mean."""
    return float(compute_iqm([np.array([run.efficiency for run in runs])]))


def join_lines(old: Iterable[BaselineRun], new: Iterable[BaselineRun]) -> list[BaselineRun]:
    """All lines, new ones in place of old ones about the same run."""
    return list({line.place: line for line in (*old, *new)}.values())


@contextmanager
def joining_lines(path: Path, new: Sequence[BaselineRun]) -> Iterator[list[BaselineRun]]:
    """Join lines with those that a file has by now, and yield all, for the page that is written of them.

    Commands that end at once take turns, the page included, so that none loses the lines of another.

    Raises:
        FileReadError: the file is damaged.
        FileWriteError: it cannot be written.
    """
    with taking_turns(path.parent):
        lines = join_lines(load_lines(path) if path.exists() else [], new)
        if new:
            save_lines(path, lines)
        yield lines


def save_lines(path: Path, lines: Iterable[DataLine]) -> None:
    """Write lines, in an order that does not depend on who made which.

    Raises:
        FileWriteError: the file cannot be written.
    """
    rows = [json.dumps(dataclasses.asdict(line), separators=(",", ":"), allow_nan=False)
            for line in sorted(lines, key=lambda line: line.place)]
    write_text(path, "".join(f"{row}\n" for row in rows))


def load_lines(path: Path) -> list[BaselineRun]:
    """Read lines about runs.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    return load_data_lines(path, BaselineRun)


def load_data_lines(path: Path, kind: type[DataLineT]) -> list[DataLineT]:
    """Read lines of a kind.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    try:
        return [read_record(kind, json.loads(row)) for row in read_text(path).splitlines()]
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, ValueError) as error:
        raise FileReadError(f"{path}: these lines are damaged ({describe_damage(error)})") from error
