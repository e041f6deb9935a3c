"""Result files: a card and the result in every test room of a rung, with the means to make and to replay one."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import hrl_escape
from benchmarks.leaderboard.program import ProgramAgent
from hrl_escape.agents.spec import REFERENCES, OptionsView
from hrl_escape.agents.training.archive import pack_run
from hrl_escape.agents.training.results import load_result
from hrl_escape.agents.training.run_folder import read_run
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.agent_archive import (
    AgentArchive,
    AgentCard,
    RoomResult,
    RoomView,
    check_results,
    find_rung,
    write_archive,
)
from hrl_escape.benchmark.pretrained import find_pretrained, open_archive
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.replay import CheckedResult, PlayerMaker, play_rooms, replay
from hrl_escape.errors import (
    ConfigError,
    EscapeError,
    FileReadError,
    TrustError,
    UnsupportedError,
    VerificationError,
    describe_damage,
)
from hrl_escape.files import read_json, write_json
from hrl_escape.sets.rung import Rung
from hrl_escape.settings import read_record, replace_settings
from hrl_escape.version import __version__, find_versions

_DEFAULTS = {"options": None, "discounted_reward": False, "observation": "pass", "planner": "auto"}
"""Arguments of `OptionsEnv` that a view leaves at their defaults."""


@dataclasses.dataclass(frozen=True)
class Result:
    """Result file of one agent on one rung."""

    card: AgentCard
    results: tuple[RoomResult, ...]
    command: tuple[str, ...] = ()
    """Command that starts a program; its files are in the folder next to the result file, of the same name."""

    def save(self, path: Path) -> None:
        """Write the file."""
        write_json(path, {**dataclasses.asdict(self), "card": self.card.to_dict()}, indent=None)


def load(path: Path) -> Result:
    """Read a result file.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    value = read_json(path, "result file")
    try:
        found = read_record(Result, value)
        check_results(found.card, found.results)
    except (EscapeError, KeyError, TypeError) as error:
        raise FileReadError(f"{path}: this is no result file ({describe_damage(error)})") from error
    return found


def describe_package() -> dict[str, Any]:
    """Version of the package, SHA-256 of its sources, and versions of the libraries that decide numbers."""
    return {"version": __version__, "sha256": _hash_package(), "libraries": find_versions()}


@functools.cache
def _hash_package() -> str:
    root, whole = Path(str(hrl_escape.__file__)).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        content = path.read_bytes()
        whole.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


# --- replaying --------------------------------------------------------------------------


def check(path: Path, rooms: int, seed: int, archive: Path | None = None, trust: bool = False, manifest: str = ""
          ) -> list[CheckedResult]:
    """Replay some rooms of a result file.

    Args:
        path: the result file. Its agent is a reference, an archive or a folder of a program next to it, or an agent
            that comes with the package.
        rooms: number of rooms.
        seed: of the draw of rooms.
        archive: archive of the agent, in place of the one next to the file.
        trust: start the program; read it before.
        manifest: file of a benchmark that does not come with the package.

    Raises:
        TrustError: the agent is a program and `trust` is not given.
        FileReadError: the agent is missing.
        VerificationError: the rooms are not the card's, or the archive is another agent's.
    """
    found = load(path)
    test = find_rung(found.card, manifest).test
    with _opening(found, path, archive, trust) as make_player:
        return replay(found.results, found.card.view, test, rooms, seed, make_player)


@contextmanager
def _opening(found: Result, path: Path, archive: Path | None, trust: bool) -> Iterator[PlayerMaker]:
    card = found.card
    if found.command:
        if not trust:
            raise TrustError([" ".join(found.command)], "this result file would start")
        with _starting(card.name, found.command, path.with_suffix("")) as make_player:
            yield make_player
    elif card.agent in REFERENCES:
        yield lambda env, recorder: make_reference(card.agent, env, recorder)
    else:
        own = path.with_suffix(".zip")
        archive = archive or (own if own.exists() else find_pretrained(f"{card.benchmark}/{card.rung}", card.name))
        with tempfile.TemporaryDirectory() as made:
            packed, run = open_archive(archive, Path(made))
            if dataclasses.replace(packed.card, package={}) != dataclasses.replace(card, package={}):
                raise VerificationError(f"{archive} is the archive of another agent than {path} names")
            yield lambda env, recorder: load_agent(run, env)


@contextmanager
def _starting(name: str, command: tuple[str, ...], folder: Path) -> Iterator[PlayerMaker]:
    """Start a program in a copy of its folder."""
    if not folder.is_dir():
        raise FileReadError(f"{folder}: no folder with the files of the program")
    with tempfile.TemporaryDirectory() as made, ExitStack() as programs:
        copy = shutil.copytree(folder, Path(made) / "program")
        yield lambda env, recorder: programs.enter_context(
            ProgramAgent(name, command, copy, getattr(env.observation_space, "words", ())))


# --- making -----------------------------------------------------------------------------


def make(rung: Rung, card: Mapping[str, Any], source: str, rooms: int | None = None) -> Result:
    """Test a reference or a program in the rooms of a rung.

    Args:
        rung: the rung.
        card: fields of `AgentCard`, where rung and package are filled in, and `command` for a program.
        source: name of a reference, or folder of a program.
        rooms: number of test rooms, from the first; all by default.
    """
    fields = dict(card)
    command = tuple(fields.pop("command", ()))
    if (source in REFERENCES) == bool(command):
        raise ConfigError("source", source, "the name of a reference, or a folder with a `command` in the card")
    made = _fill_in(rung, fields, source if source in REFERENCES else "", rooms)
    if not command:
        results = play_rooms(made.view, rung.test, range(made.rooms),
                             lambda env, recorder: make_reference(source, env, recorder))
        return Result(made, tuple(results))
    with _starting(made.name, command, Path(source)) as make_player:
        return Result(made, tuple(play_rooms(made.view, rung.test, range(made.rooms), make_player)), command)


def pack(path: Path, rung: Rung, card: Mapping[str, Any], folder: Path, rooms: int | None = None) -> AgentArchive:
    """Test the agent of a training run in the rooms of a rung, and write its archive.

    Args:
        path: archive to write.
        rung: the rung.
        card: as in `make`; view and costs come from the run.
        folder: folder of the run.
        rooms: number of test rooms, from the first; all by default.

    Raises:
        UnsupportedError: the run's environment has wrappers that a view does not describe.
    """
    described = read_run(folder)
    made = dataclasses.replace(_fill_in(rung, card, described["name"], rooms), view=read_view(described))
    if (folder / "result.json").exists():
        result = load_result(folder)
        made = replace_settings(made, {"primitives": result.primitives,
                                       "core_hours": round(result.seconds / 3600, 4)})
    results = play_rooms(made.view, rung.test, range(made.rooms), lambda env, recorder: load_agent(folder, env))
    with tempfile.TemporaryDirectory() as temporary:
        run = Path(temporary) / "run.zip"
        pack_run(folder, run, is_frozen=True)
        return write_archive(path, made, results, run)


def _fill_in(rung: Rung, card: Mapping[str, Any], agent: str, rooms: int | None) -> AgentCard:
    count = rung.record.test.count if rooms is None else rooms
    if not 1 <= count <= rung.record.test.count:
        raise ConfigError("rooms", count, f"from 1 to {rung.record.test.count}, the test rooms of {rung.name}")
    return AgentCard.from_dict({**card, "agent": agent, "benchmark": rung.benchmark, "rung": rung.name,
                                "root": rung.record.test.root, "rooms": count, "package": describe_package()})


def read_view(described: Mapping[str, Any]) -> RoomView:
    """Return the observation and actions that a described run gave its agent.

    Raises:
        UnsupportedError: the run has wrappers that a view does not describe.
    """
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
                raise UnsupportedError(f"a run with the wrapper {kind} cannot be packed: only rooms with OptionsEnv, "
                                       "of the package's own options, and DecisionMemory can")
        seen = env["arguments"]["observation"]
        return RoomView(seen, "primitives") if options is None else RoomView(
            seen, options=dataclasses.replace(options, memory=memory))
    except (KeyError, TypeError, AttributeError) as error:
        raise UnsupportedError("this run cannot be packed: it was not made in rooms of this package") from error
