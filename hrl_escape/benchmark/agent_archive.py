"""Archives of trained agents: a card, the result in each test room, and the training run.

An archive (`agents/training/archive.py`) has three parts: `card.json`, `rooms.csv` and `run.zip`. Reading one runs no
code and writes nothing outside the folder it is given.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from hrl_escape.agents.spec import OptionsView
from hrl_escape.agents.training.archive import ArchiveKind, pack_parts, read_parts, refusing_archive
from hrl_escape.benchmark.inference import Estimate, compute_interval
from hrl_escape.benchmark.statistics import compute_efficiency, compute_mean, compute_mean_efficiency
from hrl_escape.env.observations.base import get_observation
from hrl_escape.errors import ConfigError, VerificationError
from hrl_escape.files import parse_json
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark
from hrl_escape.sets.rung import Rung
from hrl_escape.sets.seasons import split_season
from hrl_escape.settings import Range, Settings, read_record

CARD, ROOMS, RUN = "card.json", "rooms.csv", "run.zip"
"""Parts of an archive."""
AGENT_ARCHIVE = ArchiveKind("a trained agent", re.compile(r"card\.json|rooms\.csv|run\.zip"),
                            "Convert an archive of version 0.3 with `hrl-escape convert`, or make a new one with "
                            "`python -m benchmarks.pretrained`")
LONGEST_CARD_TEXT = 200


@dataclasses.dataclass(frozen=True)
class RoomView(Settings):
    """Observation and actions of an agent in a room."""

    _section = "view"
    observation: str = "objects"
    """Vector observation by name."""
    choices: Literal["options", "primitives"] = "options"
    """Options to choose among, or the primitives alone."""
    options: OptionsView = OptionsView(include_primitives=False)
    """Form of the options."""

    def check(self) -> None:
        """Require a vector observation."""
        if not get_observation(self.observation).is_vector:
            raise ConfigError("view.observation", self.observation, "an observation that is a vector, such as objects")


@dataclasses.dataclass(frozen=True)
class AgentCard(Settings):
    """Card of a trained agent: authors, training, cost, and the rooms it was tested in."""

    _section = "card"
    name: str
    """Name of the agent."""
    agent: str
    """Agent or reference of this package by name; empty for a program."""
    authors: tuple[str, ...]
    """Names of its authors."""
    benchmark: str
    """Name of the benchmark."""
    rung: str
    """Name of the rung."""
    root: str
    """Hash of the rung's test set."""
    rooms: Annotated[int, Range(1, 10**6)]
    """Number of test rooms, from the first, that the agent was tested in."""
    information: str = "nothing"
    """Information that the agent has besides its observations."""
    link: str = ""
    """Address of code or paper, https://..."""
    training: str = ""
    """Command or sentence that describes the training."""
    primitives: Annotated[int, Range(0, 10**15)] | None = None
    """Primitives of training."""
    core_hours: Annotated[float, Range(0, 10**9)] | None = None
    """Hours of one core that training took."""
    view: RoomView = RoomView()
    """Observation and actions of the agent."""
    package: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Version and SHA-256 of the package, and versions of libraries, that the results were made with."""

    def check(self) -> None:
        """Require short printable texts and a link that is an address."""
        for text in (self.name, self.information, self.link, self.training, *self.authors):
            if len(text) > LONGEST_CARD_TEXT or not text.isprintable():
                raise ConfigError("card", text, f"printable text of at most {LONGEST_CARD_TEXT} characters")
        if not self.name.strip() or not self.authors or not self.information.strip():
            raise ConfigError("card", self.to_dict(), "a name, authors, and the information that the agent has")
        if self.link and not re.fullmatch(r"https://[A-Za-z0-9._~/%+?=&#-]+", self.link):
            raise ConfigError("card.link", self.link, "an address https://...")


@dataclasses.dataclass(frozen=True)
class RoomResult:
    """Result of one episode in a test room."""

    room: int  # its number in the test set
    escaped: bool
    primitives: int
    decisions: int
    total: float  # undiscounted return
    fewest: float  # primitives of the best known escape, or their expectation where moves err


@dataclasses.dataclass(frozen=True)
class AgentArchive:
    """Card and results of an archive."""

    card: AgentCard
    results: tuple[RoomResult, ...]


def find_rung(card: AgentCard, manifest: str = "") -> Rung:
    """Return the rung that a card names.

    Args:
        card: the card.
        manifest: file of a benchmark that does not come with the package.

    Raises:
        VerificationError: neither the package nor the manifest has this benchmark with this test set.
    """
    if not manifest and split_season(card.benchmark)[0] not in list_benchmarks():
        raise VerificationError(f"benchmark {card.benchmark[:40]!r} does not come with this package, which has "
                                f"{', '.join(list_benchmarks())}: give its manifest file")
    bench = load_benchmark(manifest or card.benchmark)
    rung = bench[card.rung]
    if (bench.name, rung.record.test.root) != (card.benchmark, card.root):
        raise VerificationError(f"{bench.name}/{rung.name} is not the rung of this card: the names or the hashes of "
                                "the test sets differ")
    if card.rooms > rung.record.test.count:
        raise VerificationError(f"{bench.name}/{rung.name} has {rung.record.test.count} test rooms, not {card.rooms}")
    return rung


def check_results(card: AgentCard, results: Sequence[RoomResult]) -> None:
    """Require one possible result for each room of the card.

    Raises:
        ConfigError: a result is missing or impossible.
    """
    if [result.room for result in results] != list(range(card.rooms)):
        raise ConfigError("results", len(results), f"one for each of {card.rooms} rooms, in order")
    for result in results:
        if result.primitives < 1 or not 1 <= result.decisions <= result.primitives or result.fewest < 1:
            raise ConfigError("result", dataclasses.asdict(result), "at least one decision, primitive and fewest")


def score_results(results: Sequence[RoomResult], is_expected: bool = False) -> Estimate:
    """Compute the mean efficiency over rooms, with its 95 % interval.

    Args:
        results: one for each room.
        is_expected: `fewest` are expectations; see `compute_mean_efficiency`.
    """
    escaped, primitives, fewest = np.array([(each.escaped, each.primitives, each.fewest) for each in results]).T
    value = compute_mean_efficiency(escaped, primitives, fewest, is_expected)
    each = np.minimum(compute_efficiency(escaped, primitives, fewest), 1.0)
    low, high = compute_interval(compute_mean, [each], (0.0, 1.0), np.random.default_rng(0))
    return Estimate(value, min(value, float(low)), max(value, float(high)))


def describe_score(results: Sequence[RoomResult], rung: Rung) -> str:
    """Describe efficiency and successes in one line."""
    score = score_results(results, rung.config.dynamics.is_random)
    return (f"efficiency {score:.3f} in {len(results)} test rooms, {sum(each.escaped for each in results)} escapes")


def write_archive(path: str | Path, card: AgentCard, results: Iterable[RoomResult], run: Path) -> AgentArchive:
    """Write the archive of a trained agent, atomically.

    Args:
        path: file to write.
        card: of the agent.
        results: one for each room.
        run: archive of its training run.
    """
    made, text = AgentArchive(card, tuple(results)), io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(field.name for field in dataclasses.fields(RoomResult))
    rows.writerows(dataclasses.astuple(dataclasses.replace(each, escaped=int(each.escaped))) for each in made.results)
    pack_parts(path, {CARD: json.dumps(card.to_dict(), indent=1).encode(), ROOMS: text.getvalue().encode(), RUN: run},
               AGENT_ARCHIVE)
    return made


def read_archive(path: str | Path, folder: Path | None = None) -> AgentArchive:
    """Read an archive and check its hashes.

    Args:
        path: the archive.
        folder: empty folder to write the parts to, or None.

    Raises:
        FileReadError: the file is missing or cannot be read.
        CheckpointError: it is damaged or another kind of archive.
    """
    parts, content = read_parts(path, AGENT_ARCHIVE, (CARD, ROOMS), folder)
    with refusing_archive(Path(path), AGENT_ARCHIVE):
        card = AgentCard.from_dict(parse_json(content[CARD], path, "card of an agent"))
        results = tuple(map(_read_row, csv.DictReader(io.StringIO(content[ROOMS].decode()), strict=True)))
        check_results(card, results)
        if RUN not in {part.name for part in parts}:
            raise ValueError("it has no training run")
        return AgentArchive(card, results)


def _read_row(row: Mapping[str, str]) -> RoomResult:
    return read_record(RoomResult, {
        "escaped": {"0": False, "1": True}[row["escaped"]],
        **{name: int(row[name]) for name in ("room", "primitives", "decisions")},
        **{name: float(row[name]) for name in ("total", "fewest")}})
