"""Files of submissions: an agent's card, the agent, and a cell for every room that it was tested in.

An archive (`agents/training/archive.py`) of `submission.json`, `cells.csv`, and either `run.zip`, the archive of the
training run of an agent of this package, or the files of a program. Reading one runs nothing and writes nothing.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import hashlib
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

import hrl_escape
from hrl_escape.agents.training.archive import (
    ArchiveKind,
    Part,
    compute_parts_digest,
    pack_parts,
    read_parts,
    refusing_archive,
)
from hrl_escape.comparison.grid import OptionsView
from hrl_escape.comparison.inference import Estimate, compute_interval
from hrl_escape.comparison.statistics import compute_efficiency, compute_mean, compute_mean_efficiency
from hrl_escape.env.observations.base import get_observation
from hrl_escape.errors import ConfigError, VerificationError
from hrl_escape.files import parse_json
from hrl_escape.ladder.benchmark import list_benchmarks, load_benchmark
from hrl_escape.ladder.rung import Rung
from hrl_escape.settings import Range, Settings, read_record
from hrl_escape.version import __version__, find_versions

RUN = "run.zip"
"""Part that holds the training run of an agent of this package."""
_FILE = r"(?!submission\.json$|cells\.csv$|run\.zip$|manifest\.json$)[A-Za-z0-9_][A-Za-z0-9_.-]{0,39}"
SUBMISSION = ArchiveKind("a submission", re.compile(rf"submission\.json|cells\.csv|run\.zip|{_FILE}"),
                         "Make it anew with `hrl-escape ladder submit`")
MOST_FILES, LONGEST_TEXT = 12, 200
HIDDEN_ROOMS = 100
"""Rooms of a hidden test."""


@dataclasses.dataclass(frozen=True)
class RoomView(Settings):
    """Look of a room that an agent is given, and what it chooses among."""

    _section = "view"
    observation: str = "objects"
    """Vector observation by name."""
    choices: Literal["options", "primitives"] = "options"
    """Options to choose among, or the primitives alone."""
    options: OptionsView = OptionsView(include_primitives=False)
    """Form of the options."""

    def check(self) -> None:
        """Refuse what is no vector."""
        if not get_observation(self.observation).is_vector:
            raise ConfigError("view.observation", self.observation, "an observation that is a vector, such as objects")

    def __str__(self) -> str:
        if self.choices == "primitives":
            return f"primitives, {self.observation}"
        words = ["options"] + ["primitives"] * self.options.include_primitives
        words[0] += " that know the graph" * (self.options.flavour == "press-with-ancestors")
        return " and ".join(words) + f", {self.observation}" + " with memory" * self.options.memory


@dataclasses.dataclass(frozen=True)
class Card(Settings):
    """Card of an agent: who made it, what it is told, what it cost."""

    _section = "card"
    name: str
    """Name of the agent."""
    authors: tuple[str, ...]
    """Names of its authors."""
    told: str
    """Information that it has beyond what it observes, such as: nothing."""
    link: str = ""
    """Address of code or paper, https://..."""
    training: str = ""
    """Command, or a sentence, that says how it was trained."""
    primitives: Annotated[int, Range(0, 10**15)] | None = None
    """Primitives that it was trained for; of a run of this package the run's own."""
    core_hours: Annotated[float, Range(0, 10**9)] | None = None
    """Hours of one core that training took; of a run of this package the run's own."""
    view: RoomView = RoomView()
    """Look of a room that a program is given; of a run of this package the run's own."""
    command: tuple[str, ...] = ()
    """Command that starts a program, such as ["python", "agent.py"]; empty for an agent of this package."""
    files: tuple[str, ...] = ()
    """Files beside the card that the program consists of."""

    def check(self) -> None:
        """Refuse names that are paths, texts that fill a page, and commands without their files."""
        for text in (self.name, self.told, self.link, self.training, *self.authors, *self.command):
            if len(text) > LONGEST_TEXT or not text.isprintable():
                raise ConfigError("card", text, f"printable text of at most {LONGEST_TEXT} characters")
        if not self.name.strip() or not self.authors or not self.told.strip():
            raise ConfigError("card", self.to_dict(), "a name, authors, and what the agent is told")
        if self.link and not re.fullmatch(r"https://[A-Za-z0-9._~/%+?=&#-]+", self.link):
            raise ConfigError("card.link", self.link, "an address https://...")
        for name in self.files:
            if not re.fullmatch(_FILE, name):
                raise ConfigError("card.files", name, "names of files beside the card, of up to 40 plain letters")
        if bool(self.command) != bool(self.files) or len(self.files) > min(MOST_FILES, len(set(self.files))):
            raise ConfigError("card.files", self.files, f"with a command its files, at most {MOST_FILES}, each once")


@dataclasses.dataclass(frozen=True)
class Entry(Settings):
    """Statement of a submission: agent, rooms, and the package that ran them."""

    _section = "submission"
    card: Card
    """Card of the agent."""
    agent: str
    """Name of an agent or a reference of this package; empty for a program."""
    benchmark: str
    """Name of the benchmark."""
    rung: str
    """Name of the rung."""
    root: str
    """Merkle root of the rung's test set."""
    rooms: Annotated[int, Range(1, 10**6)]
    """Rooms of the test set, from the first one, that the agent was tested in."""
    beacon: str = ""
    """Round of the beacon that decided the hidden test; empty where there was none."""
    package: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Version and SHA-256 of the package, and versions of libraries, that the cells were made with."""


@dataclasses.dataclass(frozen=True)
class Cell:
    """Result in one room."""

    set: str  # `test` or `hidden`
    room: int  # its number in the set
    escaped: bool  # whether the agent got out
    primitives: int  # of the episode
    decisions: int  # of the episode
    total: float  # undiscounted return
    fewest: float  # primitives of the best known escape, or their expectation where moves err


@dataclasses.dataclass(frozen=True)
class Submission:
    """A submission that was read, or its record."""

    entry: Entry  # what it states
    cells: tuple[Cell, ...]  # a result for each room
    parts: tuple[Part, ...]  # its files

    @property
    def agent_digest(self) -> str:
        """SHA-256 of the frozen agent: its files and how it is started and shown rooms, whatever it is tested in."""
        card, own = self.entry.card, [part for part in self.parts if part.name not in ("submission.json", "cells.csv")]
        words = json.dumps([self.entry.agent, card.view.to_dict(), card.command, compute_parts_digest(own)])
        return hashlib.sha256(words.encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """JSON value of everything but the agent's files, for a board."""
        return dataclasses.asdict(self) | {"entry": self.entry.to_dict()}

    @classmethod
    def from_json(cls, value: Any) -> Submission:
        """Read the value that `to_json` gave.

        Raises:
            EscapeError: it is damaged.
        """
        found = read_record(cls, value)
        _check_cells(found.entry, found.cells)
        return found


def describe_package() -> dict[str, Any]:
    """Version of this package, SHA-256 over its sources, and versions of the libraries that decide numbers."""
    return {"version": __version__, "sha256": _hash_package(), "libraries": find_versions()}


@functools.cache
def _hash_package() -> str:
    root, whole = Path(str(hrl_escape.__file__)).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        content = path.read_bytes()
        whole.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


def find_rung(entry: Entry, manifest: str = "") -> Rung:
    """The rung that a submission is about; its names never become paths.

    Raises:
        VerificationError: neither the package nor the manifest, a file, has this benchmark with this test set.
    """
    if not manifest and entry.benchmark not in list_benchmarks():
        raise VerificationError(f"benchmark {entry.benchmark[:40]!r} does not come with this package, which has "
                                f"{', '.join(list_benchmarks())}: give its manifest by --benchmark FILE")
    bench = load_benchmark(manifest or entry.benchmark)
    rung = bench[entry.rung]
    if (bench.name, rung.record.test.root) != (entry.benchmark, entry.root):
        raise VerificationError(f"{bench.name}/{rung.name} is not what this submission was tested in: the names or the "
                                "roots of the test sets differ")
    if entry.rooms > rung.record.test.count:
        raise VerificationError(f"{bench.name}/{rung.name} has {rung.record.test.count} test rooms, not {entry.rooms}")
    return rung


def score_cells(cells: Sequence[Cell], is_expected: bool = False) -> Estimate:
    """Mean efficiency over rooms, with its 95 % interval; for `is_expected` see `compute_mean_efficiency`."""
    escaped, primitives, fewest = np.array([(cell.escaped, cell.primitives, cell.fewest) for cell in cells]).T
    value = compute_mean_efficiency(escaped, primitives, fewest, is_expected)
    each = np.minimum(compute_efficiency(escaped, primitives, fewest), 1.0)
    low, high = compute_interval(compute_mean, [each], (0.0, 1.0), np.random.default_rng(0))
    return Estimate(value, min(value, float(low)), max(value, float(high)))


def write_submission(path: str | Path, entry: Entry, cells: Iterable[Cell], agent: Mapping[str, Path | bytes]
                     ) -> Submission:
    """Write a submission of `run.zip`, the files of a program, or nothing for a reference, atomically."""
    cells, text = tuple(cells), io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(field.name for field in dataclasses.fields(Cell))
    rows.writerows(dataclasses.astuple(dataclasses.replace(cell, escaped=int(cell.escaped))) for cell in cells)
    stated = json.dumps(entry.to_dict(), indent=1).encode()
    sources = {"submission.json": stated, "cells.csv": text.getvalue().encode(), **agent}
    return Submission(entry, cells, pack_parts(path, sources, SUBMISSION))


def read_submission(path: str | Path, folder: Path | None = None) -> Submission:
    """Read a submission and check its hashes, and write its parts to an empty folder if one is given; none is run.

    Raises:
        FileReadError: there is none, or it may not be read.
        CheckpointError: it is damaged or no submission.
    """
    parts, content = read_parts(path, SUBMISSION, ("submission.json", "cells.csv"), folder)
    with refusing_archive(Path(path), SUBMISSION):
        entry = Entry.from_dict(parse_json(content["submission.json"], path, "submission"))
        cells = tuple(map(_read_cell, csv.DictReader(io.StringIO(content["cells.csv"].decode()), strict=True)))
        _check_cells(entry, cells)
        names = {part.name for part in parts} - {"submission.json", "cells.csv"}
        if names != (set(entry.card.files) if not entry.agent else names & {RUN}):
            raise ValueError("its files are not those of its card")
        return Submission(entry, cells, parts)


def _read_cell(row: Mapping[str, str]) -> Cell:
    return read_record(Cell, {
        "set": row["set"], "escaped": {"0": False, "1": True}[row["escaped"]],
        **{name: int(row[name]) for name in ("room", "primitives", "decisions")},
        **{name: float(row[name]) for name in ("total", "fewest")}})


def _check_cells(entry: Entry, cells: Sequence[Cell]) -> None:
    """Refuse all but one possible result for each room that is stated."""
    places = [("test", room) for room in range(entry.rooms)]
    places += [("hidden", room) for room in range(HIDDEN_ROOMS if entry.beacon else 0)]
    if [(cell.set, cell.room) for cell in cells] != places:
        raise ConfigError("cells", len(cells), f"one for each of {len(places)} rooms, in order")
    for cell in cells:
        if cell.primitives < 1 or not 1 <= cell.decisions <= cell.primitives or cell.fewest < 1:
            raise ConfigError("cell", dataclasses.asdict(cell), "at least one decision, primitive and fewest")
