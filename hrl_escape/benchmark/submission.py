"""Submissions: a frozen agent, its card and what it did in every test room of a rung, in one file that can be verified.

The file is an archive (`agents/training/archive.py`) of `submission.json`, `cells.csv`, and either `run.zip`, the
archive of the training run of an agent of this package, or the files of a program. Reading one runs nothing and writes
nothing. A cell is the result in one room, played alone and to the same bits when it is submitted and when it is
verified.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import hashlib
import io
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

import hrl_escape
from hrl_escape.agents.agent import Agent, FixedPolicy, SMDPTransition
from hrl_escape.agents.spec import REFERENCES, AgentSpec, OptionsView
from hrl_escape.agents.training.archive import (
    ArchiveKind,
    Part,
    compute_parts_digest,
    pack_parts,
    pack_run,
    read_parts,
    refusing_archive,
    unpack_run,
)
from hrl_escape.agents.training.evaluation import compute_episode_seed, play_episode
from hrl_escape.agents.training.results import load_result
from hrl_escape.agents.training.run_folder import read_run
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.inference import Estimate, compute_interval
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.benchmark.score_range import compute_score_range
from hrl_escape.benchmark.statistics import compute_efficiency, compute_mean, compute_mean_efficiency
from hrl_escape.env.observations.base import get_observation
from hrl_escape.errors import (
    CheckpointError,
    ConfigError,
    ContractError,
    TrustError,
    UnsupportedError,
    VerificationError,
    show_value,
)
from hrl_escape.files import parse_json, read_bytes, write_json
from hrl_escape.names import parse_whole
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.rung import Rung, read_beacon
from hrl_escape.settings import Range, Settings, read_record, replace_settings
from hrl_escape.version import __version__, find_versions

RUN = "run.zip"
"""Part that holds the training run of an agent of this package."""
_FILE = r"(?!submission\.json$|cells\.csv$|run\.zip$|manifest\.json$)[A-Za-z0-9_][A-Za-z0-9_.-]{0,39}"
SUBMISSION = ArchiveKind("a submission", re.compile(rf"submission\.json|cells\.csv|run\.zip|{_FILE}"),
                         "Make it anew with `hrl-escape ladder submit`, or `hrl-escape convert` one of version 0.3")
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
        words[0] += " that know the graph" * (self.options.option_set == "press-with-ancestors")
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
        """Read the value that `to_json` gave; `EscapeError` where it is damaged."""
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


# --- programs ----------------------------------------------------------------------------

ANSWER_SECONDS = 120.0
"""Seconds that a program may take for a decision; its start counts with the first."""
LONGEST_LINE = 100


def describe_command(card: Card) -> str:
    """Words on what will be started."""
    return f"{' '.join(card.command)} (files: {', '.join(card.files)}), in a process of its own"


class ProgramAgent(FixedPolicy):
    """A program in a process of its own as an agent; leaving its `with` block ends it and all that it has started.

    For every decision the program reads one line of JSON from its standard input,

        {"observation": [0.0, 1.0, ...], "mask": [1, 0, 1], "start": true, "words": ["present", ...]}

    the vector that it observes, 1 for each action that is legal, whether an episode begins, and then what the numbers
    of a row of `objects` mean; and it writes one line, the number of its action. Neither room, seed, reward nor `info`
    reach it. Its folder holds its files alone, its environment no variable of the caller's but PATH. What it does
    beyond that on the machine nothing here forbids: it is started where the caller trusts it.

    Args:
        card: says which command.
        folder: with the program's files; its working folder.
        words: names of the numbers of a row, where the observation has rows.
    """

    def __init__(self, card: Card, folder: Path, words: Sequence[str] = ()) -> None:
        self._name, self._words, self._is_start = card.name, list(words), True
        self._log = folder / "stderr.txt"
        first, *others = card.command
        surroundings = {"PATH": os.environ.get("PATH", os.defpath), "HOME": str(folder), "TMPDIR": str(folder),
                        "LANG": "C.UTF-8", "OMP_NUM_THREADS": "1"}
        try:
            with open(self._log, "wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable if first == "python" else first, *others], cwd=folder, env=surroundings,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=0, start_new_session=True)
        except (OSError, ValueError) as error:
            reason = str(getattr(error, "strerror", None) or error)
            raise ContractError(card.name, f"{show_value(first)} can be started", reason) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in filter(None, (self._process.stdin, self._process.stdout)):
            with suppress(OSError):
                pipe.close()

    def act(self, observation: NDArray[np.floating], action_mask: NDArray[np.bool_]) -> int:
        """Ask the program; `ContractError` where it has ended, is silent, or answers what is no legal action."""
        look = {"observation": np.asarray(observation, np.float64).tolist(),
                "mask": np.asarray(action_mask).astype(int).tolist(), "start": self._is_start}
        look |= {"words": self._words} if self._is_start else {}
        self._is_start = False
        answer = self._ask(json.dumps(look).encode() + b"\n")
        action = parse_whole(answer.strip())
        if action is None or action >= len(action_mask) or not action_mask[action]:
            legal = ", ".join(map(str, np.flatnonzero(action_mask)))
            raise ContractError(self._name, f"it answers with a legal action's number ({legal[:LONGEST_LINE]})",
                                show_value(answer[:LONGEST_LINE]))
        return action

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Tell the program at its next decision where an episode has ended."""
        self._is_start = transition.terminated or transition.truncated

    def _ask(self, line: bytes) -> str:
        source, answer = self._process.stdout, b""
        assert source is not None and self._process.stdin is not None
        try:
            self._process.stdin.write(line)
            while not answer.endswith(b"\n") and len(answer) <= LONGEST_LINE:
                if not select.select([source], [], [], ANSWER_SECONDS)[0]:
                    raise ContractError(self._name, f"it answers within {ANSWER_SECONDS:.0f} s", "nothing")
                piece = os.read(source.fileno(), LONGEST_LINE)
                if not piece:
                    raise BrokenPipeError
                answer += piece
        except BrokenPipeError:
            last = self._log.read_bytes()[-2000:].decode(errors="replace").strip().splitlines()[-1:]
            raise ContractError(self._name, "it answers until it is ended",
                                f"its end, and last {show_value(last[0] if last else 'no word')}") from None
        return answer.decode(errors="replace")


# --- playing -----------------------------------------------------------------------------

_DEFAULTS = {"options": None, "discounted_reward": False, "observation": "pass", "planner": "auto"}
"""Arguments of `OptionsEnv` that a view leaves at their defaults."""


class CheckedCell(NamedTuple):
    """A cell of a submission, and what playing its room again gave."""

    stated: Cell
    found: Cell

    @property
    def is_equal(self) -> bool:
        """Equal to the last bit."""
        return self.stated == self.found


def read_view(described: Mapping[str, Any]) -> RoomView:
    """View that a described run gave its agent; `UnsupportedError` where a wrapper could change what counts."""
    env, options, memory = described["environment"], None, False
    try:
        for wrapper in env["wrappers"]:
            kind, given = wrapper["class"].rpartition(":")[2], wrapper["arguments"]
            if kind == "OptionsEnv" and options is None and _DEFAULTS.items() <= given.items():
                names = {field.name for field in dataclasses.fields(OptionsView)} - {"memory"}
                options = OptionsView(**{name: given[name] for name in names})
            elif kind == "DecisionMemory" and options is not None:
                memory = True
            elif kind != "RoomSchedule":
                raise UnsupportedError(f"a run with {kind} around its room cannot be submitted: a board knows rooms "
                                       "with OptionsEnv, of the package's own options, and DecisionMemory")
        seen = env["arguments"]["observation"]
        return RoomView(seen, "primitives") if options is None else RoomView(
            seen, options=dataclasses.replace(options, memory=memory))
    except (KeyError, TypeError, AttributeError) as error:
        raise UnsupportedError("this run was not made in rooms of this package, so that it cannot be submitted"
                               ) from error


def make_view_env(view: RoomView, rooms: InstanceSet, schedule: Mapping[str, int] | None = None
                  ) -> tuple[gymnasium.Env, StateRecorder]:
    """Environment over a set of rooms as a view shows it; see `make_agent_env`."""
    name = "random-options" if view.choices == "options" else "random"
    return make_agent_env(AgentSpec(name, options=view.options), rooms, view.observation, schedule)


def play_cells(entry: Entry, folder: Path, rooms: InstanceSet, role: str, numbers: Iterable[int], trust: bool = False
               ) -> Iterator[Cell]:
    """Play an episode in each of some rooms of a set; which others are played makes no difference.

    A program must be trusted (`TrustError`) and answer as agreed (`ContractError`).
    """
    seeds = {number: compute_episode_seed(0, "evaluation" if role == "test" else role, number) for number in numbers}
    env, recorder = make_view_env(entry.card.view, rooms, {str(seed): number for number, seed in seeds.items()})
    room: Any = env.unwrapped
    with closing(env), _opening(entry, folder, env, recorder, trust) as player, tempfile.TemporaryDirectory() as cache:
        for number, seed in seeds.items():
            primitives, decisions, total, escaped = 0, 0, 0.0, False
            for step, info in play_episode(player, env, seed):
                primitives, decisions, total = primitives + step.duration, decisions + 1, total + step.summed_reward
                escaped = bool(info["is_success"])
            known = compute_score_range([(room.instance, recorder.states[0])], AgentSpec(), Path(cache))
            yield Cell(role, number, escaped, primitives, decisions, total, float(known.fewest[0]))


@contextmanager
def _opening(entry: Entry, folder: Path, env: gymnasium.Env, recorder: StateRecorder, trust: bool) -> Iterator[Agent]:
    if not entry.agent:
        if not trust:
            raise TrustError([describe_command(entry.card)], "this submission would start")
        with ProgramAgent(entry.card, folder, getattr(env.observation_space, "words", ())) as program:
            yield program
    elif entry.agent in REFERENCES:
        yield make_reference(entry.agent, env, recorder)
    else:
        if not (folder / "run").exists():
            named = unpack_run(folder / RUN, folder / "run").described.get("name")
            if named != entry.agent:
                raise CheckpointError(f"this submission is of {show_value(entry.agent)}, and its run trained "
                                      f"{show_value(named)}")
        yield load_agent(folder / "run", env)


def pack_submission(path: Path, rung: Rung, card: Card, source: str = "", files: Path = Path(),
                    rooms: int | None = None, beacon: str = "") -> Submission:
    """Test a frozen agent in a rung's rooms, and write the submission.

    Args:
        path: the file to write.
        rung: of a benchmark.
        card: of the agent; view and costs of a run are filled in from the run.
        source: folder of a training run, or a reference such as `search-nearest`; empty for the card's program.
        files: folder of the program's files.
        rooms: number of test rooms, from the first; all by default.
        beacon: round that decides the hidden test, which the benchmark has announced; empty for no hidden test.

    Raises:
        ConfigError: an impossible number of rooms, or a round that was not announced.
        UnsupportedError: the run's environment is none that a board knows.
    """
    count = rung.record.test.count if rooms is None else rooms
    if not 1 <= count <= rung.record.test.count:
        raise ConfigError("rooms", count, f"from 1 to {rung.record.test.count}, the test rooms of {rung.name}")
    if beacon and rung.hidden_round is None:
        raise ConfigError("beacon", beacon, f"none, for {rung.benchmark} has announced no round")
    if bool(source) == bool(card.command):
        raise ConfigError("source", source, "a run or a reference, or a command in the card: one of the two")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        if source in REFERENCES:
            agent, parts = source, {}
        elif source:
            agent, card = read_run(source)["name"], _fill_in(card, Path(source))
            pack_run(source, folder / RUN, is_frozen=True)
            parts = {RUN: folder / RUN}
        else:
            agent, parts = "", {name: read_bytes(files / name, "file of a program") for name in card.files}
            for name, content in parts.items():
                (folder / name).write_bytes(content)
        entry = Entry(card, agent, rung.benchmark, rung.name, rung.record.test.root, count,
                      str(read_beacon(beacon)) if beacon else "", describe_package())
        cells = [cell for role, tested in _list_sets(entry, rung).items()
                 for cell in play_cells(entry, folder, tested, role, range(len(tested)), trust=True)]
        return write_submission(path, entry, cells, parts)


def _fill_in(card: Card, folder: Path) -> Card:
    """Card with what a run says itself: how rooms looked, and its cost where the run is finished."""
    card = dataclasses.replace(card, view=read_view(read_run(folder)))
    if not (folder / "result.json").exists():
        return card
    result = load_result(folder)
    return replace_settings(card, {"primitives": result.primitives, "core_hours": round(result.seconds / 3600, 4)})


def _list_sets(entry: Entry, rung: Rung) -> dict[str, InstanceSet]:
    hidden = {"hidden": rung.make_hidden_test(entry.beacon, HIDDEN_ROOMS)} if entry.beacon else {}
    return {"test": rung.test[: entry.rooms]} | hidden


def verify_cells(path: Path, rung: Rung, count: int, seed: int, trust: bool = False) -> list[CheckedCell]:
    """Play some cells of a submission again, drawn by a seed that whoever submits must not know; see `play_cells`."""
    with tempfile.TemporaryDirectory() as made:
        submission = read_submission(path, Path(made))
        drawn = draw_cells(submission.cells, count, seed)
        found = {}
        for role, rooms in _list_sets(submission.entry, rung).items():
            numbers = [cell.room for cell in drawn if cell.set == role]
            if numbers:
                found |= {(role, cell.room): cell
                          for cell in play_cells(submission.entry, Path(made), rooms, role, numbers, trust)}
        return [CheckedCell(cell, found[cell.set, cell.room]) for cell in drawn]


def draw_cells(cells: Sequence[Cell], count: int, seed: int) -> list[Cell]:
    """Draw different cells, in order."""
    if not 1 <= count <= len(cells):
        raise ConfigError("cells", count, f"from 1 to {len(cells)}, those of the submission")
    return [cells[number] for number in sorted(np.random.default_rng(seed).choice(len(cells), count, replace=False))]


# --- records -----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Check:
    """Verification of a submission: rooms played again, the seed that drew them, and the package's version."""

    cells: int
    seed: int
    version: str


@dataclasses.dataclass(frozen=True)
class Record:
    """A submission without its agent's files, and how it was verified."""

    submission: Submission
    check: Check

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        value = {"submission": self.submission.to_json(), "check": dataclasses.asdict(self.check)}
        write_json(path, value, indent=None)


def describe_score(submission: Submission, rung: Rung) -> str:
    """Words on a submission's efficiency and escapes."""
    words = []
    for role in ("test", "hidden"):
        cells = [cell for cell in submission.cells if cell.set == role]
        if cells:
            score = score_cells(cells, rung.config.dynamics.is_random)
            words.append(f"efficiency {score:.3f} in {len(cells)} {role} rooms, "
                         f"{sum(cell.escaped for cell in cells)} escapes")
    return "; ".join(words)
