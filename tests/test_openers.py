"""Every function that opens a file of a user's, and files in its place that block, swell or lie.

The package is searched for calls that open files. Each is one of the guarded readers of `files.py`, or is reviewed
below. Each function that calls a guarded reader is reached by a door of `DOORS`, and every file of a door is replaced
by each of `PLANTS`.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import functools
import io
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import tracemalloc
import types
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import hrl_escape
from hrl_escape.agents import load_agent, load_result, train
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.archive import describe_part, pack_run, read_summary
from hrl_escape.agents.training.env_description import hash_files
from hrl_escape.agents.training.plots import read_csv_curve
from hrl_escape.benchmark.conversion import convert_file
from hrl_escape.benchmark.env_spec import _find_part
from hrl_escape.benchmark.grid import load_grid
from hrl_escape.benchmark.launching.local import _read_tail, read_progress
from hrl_escape.benchmark.models import _resume
from hrl_escape.benchmark.run_results import get_run_folder, load_run_result, read_episodes
from hrl_escape.data import load_data
from hrl_escape.data.convert import convert_data
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.presets import get_preset
from hrl_escape.env.robot import load_urdf, make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError
from hrl_escape.files import write_json
from hrl_escape.planning.arm.srdf import read_srdf
from hrl_escape.planning.fixed_arm import Arm
from hrl_escape.planning.world import World
from hrl_escape.sets.grammar import find_rooms
from hrl_escape.sets.manifest import load_manifest
from hrl_escape.sets.places import RunPlace
from hrl_escape.text.chat import Budget
from hrl_escape.text.recordings import RecordedModel, record_game
from hrl_escape.text.text_env import RoomSession
from hrl_escape.viewer.play.episode import load_episode
from tests.agents.small_envs import ButtonGrid
from tests.benchmark.small import SMALL

PACKAGE = Path(hrl_escape.__file__).parent
READERS = ("open_plain", "list_members", "read_bytes", "read_text", "read_json", "read_toml", "check_files")
"""Guarded readers of `files.py`."""
RAW = {"open", "fdopen", "read_text", "read_bytes", "ZipFile", "is_zipfile", "loadURDF", "MeshLoader", "fromfile",
       "loadtxt", "genfromtxt", "memmap", "imread", "imopen", "imiter", "TarFile", "GzipFile", "parse_file",
       "buildModelFromUrdf", "read_csv", "scandir", "exec_module", "load_dataset", "run_path", "copyfile", "copy2",
       "copytree"}
"""Names of calls that open files by themselves."""
LIBRARIES = ("np.load", "numpy.load", "torch.load", "pickle.load", "joblib.load", "ElementTree.parse", "shutil.copy")
LAST = {name.rpartition(".")[2] for name in LIBRARIES}
REVIEWED = {
    "files.py": "the guarded readers",
    "cli.py::_drop_output": "the null device",
    "cli.py::find_commands": "modules of the package", "cli.py::_summarise": "modules of the package",
    "commands/list.py::_parse_agent": "modules of the package",
    "commands/compare.py::run": "a page that was just written, in the browser",
    "commands/play.py::announce": "an address on this machine, in the browser",
    "commands/mcp.py::_wire": "standard input and output",
    "kernels.py::_copy_whole": "kernels of this installation",
    "kernels.py::hash_code": "modules of the package",
    "templates.py::render_template": "templates of the package",
    "benchmark/cost.py::load_rates": "a table of the package",
    "benchmark/reporting/report.py::_read": "scripts of the package",
    "env/pictures/moving_map.py::make_moving_map": "scripts of the package",
    "env/pictures/video.py::_make_mp4": "a video that was just written, in a temporary folder",
    "env/mesh_files.py::_read_by_assimp": "a copy of a file that a guarded reader has read",
    "agents/training/archive.py::pack_parts": "an archive that is written",
    "agents/training/archive.py::read_parts": "members of an open archive, and new files in a new folder",
    "agents/training/checkpoint.py::_read_array": "members of an open archive",
    "agents/training/env_description.py::load_file": "a Python file that a guarded reader has read",
    "data/played.py::from_minari": "a data set by the name that Minari gave it",
    "data/recording.py::_read": "members of an open archive",
    "agents/training/train.py::train": "a run's folder, which reads through `run_folder.py`",
    "processes.py::taking_turns": "a folder that was just made",
    "env/urdf.py::_list_folders": "names in a folder",
    "env/bullet/cameras.py": "a URDF that was just written, in a temporary folder",
    "env/bullet/physics.py": "a URDF that was just written, in a temporary folder",
    "planning/occupancy_grid.py::_read_image": "bytes that were read by `read_bytes`",
}
"""Calls that open files by other means, and the reason. A file without a function stands for all of its functions."""
OWN = ("benchmark/rung_references.py::load_references", "data/published.py::_read", "sets/manifest.py::_load_own",
       "planning/arm/shapes.py::_read_corners")
"""Functions that read tables and caches of the package alone."""


class Call(NamedTuple):
    """A call that opens a file: the file and function that it is in, and whether it is a guarded reader."""

    place: str
    text: str
    is_guarded: bool


@functools.cache
def list_openings() -> tuple[Call, ...]:
    """Calls of the package that open files."""
    found, words = [], re.compile(rf"\b({'|'.join((*READERS, *RAW, *LAST))})\(")
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        stack: list[tuple[ast.AST, str]] = [(ast.parse(text), "")] if words.search(text) else []
        while stack:
            node, function = stack.pop()
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                function = node.name
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                is_guarded = isinstance(node.func, ast.Name) and name in READERS
                if is_guarded or name in RAW or (name in LAST and ast.unparse(node.func) in LIBRARIES):
                    place = f"{path.relative_to(PACKAGE).as_posix()}::{function}"
                    found.append(Call(place, ast.unparse(node), is_guarded))
            stack += [(child, function) for child in ast.iter_child_nodes(node)]
    return tuple(found)


def test_files_are_opened_by_guarded_readers_or_for_a_reason():
    found = {call.place: call.text for call in list_openings() if not call.is_guarded}
    unknown = {place: text for place, text in found.items()
               if place not in REVIEWED and place.partition("::")[0] not in REVIEWED}
    assert not unknown, f"read through hrl_escape.files, or add to REVIEWED with a reason: {unknown}"
    files = {place.partition("::")[0] for place in found}
    assert REVIEWED.keys() <= files | found.keys(), "REVIEWED names a call that is gone"


# --- doors --------------------------------------------------------------------------------------

URDF = """<robot name="r"><link name="foot"/><link name="boom"><collision><geometry>
<mesh filename="package://tool/m.obj"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="foot"/><child link="boom"/><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
SRDF = '<robot name="r"><disable_collisions link1="foot" link2="boom"/></robot>'
MESH = "mtllib {folder}/m.mtl\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 0 0 0\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
SOLID = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
MAP = {"image": "m.png", "resolution": 0.5, "origin": [0, 0, 0], "negate": 0, "occupied_thresh": 0.65,
       "free_thresh": 0.196}


def make_arm(folder: Path) -> None:
    robot = make_robot(RobotConfig(kind="urdf", urdf=load_urdf(folder / "r.urdf"), joints=1, hand_link="boom"))
    with contextlib.suppress(FileNotFoundError):
        read_srdf(folder / "r.srdf", robot)


def draw_map(path: Path) -> None:
    from PIL import Image

    Image.new("L", (16, 16), 254).save(path)


@functools.cache
def get_run() -> Path:
    """A finished run, made once."""
    folder = Path(tempfile.mkdtemp()) / "run"
    atexit.register(shutil.rmtree, folder.parent)
    continue_run(folder)
    return folder


def make_run(folder: Path) -> None:
    shutil.copytree(get_run(), folder)


def continue_run(folder: Path) -> None:
    if (folder / "result.json").is_file():
        (folder / "result.json").unlink()
    train("q-learning", ButtonGrid(horizon=10), out=folder, primitives=20, eval_every=10, eval_episodes=1,
          checkpoint_seconds=0)


def keep_best(folder: Path) -> None:
    from hrl_escape.viewer.play.commands import _keep_personal_best

    episode = types.SimpleNamespace(instance=generate(get_preset("paper-one-button"), 0), discovery=None, total=1.0)
    _keep_personal_best(episode, folder)  # type: ignore[arg-type]  # the three fields that it reads


def make_zip(path: Path, *names: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "{}")


def make_log(folder: Path) -> None:
    (folder / "training").mkdir()
    (folder / "training" / "log.jsonl").write_text('{"primitives": 1}\n')


@functools.cache
def play_game() -> str:
    session = RoomSession(EscapeRoomEnv(config="paper-one-button"))
    session.reset(seed=0)
    return "".join(f"{line}\n" for line in record_game(session).to_lines())


OLD = Path(__file__).parent / "data" / "version-0.3" / "pretrained.zip"
RUN = SMALL.make_runs([RunPlace.of_room(generate(get_preset("paper-one-button"), 0))])[0]


def find_ends(folder: Path) -> None:
    from hrl_escape.benchmark.score_range import _find_ends
    from hrl_escape.planning.best_known import list_start_states

    room = generate(get_preset("paper-one-button"), 0)
    with contextlib.suppress(OSError):
        _find_ends(room, list_start_states(room)[0], None, folder / "cache")


class Door(NamedTuple):
    """A way in.

    Attributes:
        files: paths that are replaced, within a folder.
        make: makes sound files in the folder, as far as the call needs them.
        call: opens them.
    """

    files: tuple[str, ...]
    make: Callable[[Path], object]
    call: Callable[[Path], object]


def write(**files: str) -> Callable[[Path], None]:
    """Writer of texts; two underscores stand for the dot of a file's name."""
    def make(folder: Path) -> None:
        for name, text in files.items():
            (folder / name.replace("__", ".")).write_text(text.replace("{folder}", str(folder)))
    return make


def do(*calls: Callable[[], object]) -> None:
    """Call all, even if some refuse."""
    for call in calls:
        with contextlib.suppress(EscapeError):
            call()


def make_urdf(folder: Path) -> None:
    package = "<package><name>tool</name></package>"
    write(r__urdf=URDF, m__obj=MESH, m__mtl="", package__xml=package, r__srdf=SRDF)(folder)


def save_room(name: str) -> Callable[[Path], None]:
    return lambda folder: generate(get_preset("paper-one-button"), 0).save(folder / name)


def make_old_run(folder: Path) -> None:
    make_run(folder / "run")
    described = json.loads((folder / "run" / "run.json").read_text())
    write_json(folder / "run" / "run.json", {**described, "format": 2})


DOORS: dict[str, Door] = {
    "room": Door(("x.json",), save_room("x.json"), lambda f: do(
        lambda: RoomInstance.load(f / "x.json"), lambda: find_rooms(str(f / "x.json")),
        lambda: load_manifest(f / "x.json"), lambda: RunPlace.load(f, "x"))),
    "configuration": Door(("x.toml",), write(x__toml="horizon = 5"), lambda f: do(
        lambda: find_rooms(str(f / "x.toml")), lambda: load_grid(f / "x.toml"),
        lambda: convert_file(f / "x.toml", f / "out.toml"))),
    "set": Door(("x.json",), write(x__json='{"name": "x", "seeds": [1], "config": {}}'), lambda f: do(
        lambda: find_rooms(str(f / "x.json")), lambda: load_grid(f / "x.json"),
        lambda: convert_file(f / "x.json", f / "out.json"), lambda: convert_data(f / "x.json", f / "out.json"),
        lambda: load_episode(f / "x.json"))),
    "old grid": Door(("x.toml",), write(x__toml='agents = ["dqn"]'),
                     lambda f: convert_file(f / "x.toml", f / "out.toml")),
    "run": Door(tuple(f"run/{name}" for name in ("run.json", "log.jsonl", "checkpoint.npz", "best.npz", "result.json",
                                                "lock")),
                lambda f: make_run(f / "run"), lambda f: do(
        lambda: load_agent(f / "run", ButtonGrid(horizon=10)), lambda: load_result(f / "run"),
        lambda: read_summary(f / "run"), lambda: pack_run(f / "run", f / "x.zip"),
        lambda: pack_run(f / "run", f / "y.zip", is_frozen=True),
        lambda: continue_run(f / "run"))),
    "old run": Door(("run/run.json", "run/checkpoint.npz", "run/result.json", "run/log.jsonl"), make_old_run,
                    lambda f: convert_file(f / "run", f / "out")),
    "archive": Door(("x.zip",), lambda f: shutil.copy(OLD, f / "x.zip"), lambda f: do(
        lambda: read_summary(f / "x.zip"), lambda: convert_file(f / "x.zip", f / "out.zip"),
        lambda: describe_part("run.json", f / "x.zip"))),
    "recording": Door(("x.npz",), lambda f: make_zip(f / "x.npz", "about.npy"), lambda f: do(
        lambda: load_data(f / "x.npz"), lambda: convert_data(f / "x.npz", f / "out.npz"))),
    "games": Door(("x.jsonl",), lambda f: (f / "x.jsonl").write_text(play_game()), lambda f: do(
        lambda: RecordedModel(f / "x.jsonl"), lambda: convert_data(f / "x.jsonl", f / "out.jsonl"),
        lambda: AgentSpec.parse(f"text-agent(model={json.dumps(str(f / 'x.jsonl'))})").resolve_settings())),
    "model's games": Door(("settings.json", "usage.json", "game-0.json"),
                          write(settings__json="{}", usage__json="{}", **{"game-0__json": "{}"}),
                          lambda f: _resume(f, {}, Budget())),
    "comparison": Door(("run_result.json", "episodes.json"), write(run_result__json="{}", episodes__json="[]"),
                       lambda f: do(lambda: link_run(f), lambda: load_run_result(f, RUN),
                                    lambda: read_episodes(f, RUN))),
    "progress": Door(("training/log.jsonl",), make_log, lambda f: do(
        lambda: link_run(f), lambda: read_progress(f, RUN), lambda: _read_tail(f / "training" / "log.jsonl"))),
    "curve": Door(("x.csv",), write(x__csv="step,return\n1,2\n"), lambda f: read_csv_curve(f / "x.csv")),
    "module": Door(("x.py",), write(x__py="def make(): ..."), lambda f: _find_part(f"{f / 'x.py'}:make", "env")),
    "hash of a module": Door(("x.py",), write(x__py="def make(): ..."),
                             lambda f: hash_files({"function": f"{f / 'x.py'}:make"})),
    "best known": Door((), lambda f: find_ends(f), find_ends),
    "personal bests": Door(("personal-bests.json",), lambda f: None, keep_best),
    "map": Door(("m.yaml", "m.png"), lambda f: (draw_map(f / "m.png"), write(m__yaml=json.dumps(MAP))(f)),
                lambda f: World.read(f / "m.yaml", RobotConfig(), (4.0, 4.0, 0.0))),
    "mesh": Door(("m.obj", "m.mtl"), write(m__obj=MESH, m__mtl=""), lambda f: load_mesh(f / "m.obj")),
    "mesh by assimp": Door(("m.stl",), write(m__stl=SOLID), lambda f: load_mesh(f / "m.stl")),
    "arm": Door(("r.urdf", "m.obj", "package.xml"), make_urdf, lambda f: Arm.from_urdf(
        f / "r.urdf", hand="boom", floor=-1.0).is_free([0.0])),
    "robot": Door(("r.urdf", "m.obj", "package.xml", "r.srdf"), make_urdf, make_arm),
}


def link_run(folder: Path) -> None:
    """Let the run's folder be this one."""
    place = get_run_folder(folder, RUN)
    if not place.exists():
        place.parent.mkdir(parents=True)
        place.symlink_to(folder)


# --- plants ---------------------------------------------------------------------------------------


def make_png(side: int) -> bytes:
    """Black picture of `side` x `side` pixels, in a few kB."""
    def chunk(kind: bytes, content: bytes) -> bytes:
        return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")
    head = side.to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0])
    rows = zlib.compress(bytes(side + 1) * 100)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def make_bomb() -> bytes:
    """YAML of 10^9 aliases in place of every field."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"{to}: &{to} [{', '.join([f'*{of}'] * 10)}]" for of, to in zip("abcdefgh", "bcdefghi", strict=True)]
    return "\n".join([*lines, *(f"{name}: *i" for name in MAP)]).encode()


def make_entities() -> bytes:
    entities = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "x" * 10}">' for n in range(9))
    return f'<!DOCTYPE robot [{entities}]><robot name="r"><link name="&e8;"/></robot>'.encode()


@functools.cache
def make_large_zip() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for number in range(70_000):
            archive.writestr(zipfile.ZipInfo(f"{number:0100d}"), b"")
    return file.getvalue()


def fill(content: Callable[[], bytes]) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content())


def grow(path: Path) -> None:
    with open(path, "wb") as file:
        file.truncate(10**13)


PLANTS: dict[str, Callable[[Path], object]] = {
    "pipe": lambda path: os.mkfifo(path),
    "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "folder": lambda path: path.mkdir(),
    "10 TB": grow,
    "nothing": lambda path: None,
    "empty": fill(bytes),
    "YAML bomb": fill(make_bomb),
    "XML bomb": fill(make_entities),
    "picture of 13,000 x 13,000": fill(lambda: make_png(13_000)),
    "EPS": fill(lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(%pipe%touch /tmp/x) (w) file\n"),
    "deep JSON": fill(lambda: b"[" * 10**6),
    "deep XML": fill(lambda: URDF.replace("</robot>", "<a>" * 5000 + "</a>" * 5000 + "</robot>").encode()),
    "long line": fill(lambda: b"step,return\n" + b"7" * 200_000),
    "many JSON values": fill(lambda: b'{"a":[' + b"{}," * 10**5 + b"{}]}"),
    "other bytes": fill(lambda: bytes(range(256)) * 40),
}
SECONDS = 10


@contextlib.contextmanager
def limit_seconds() -> Iterator[None]:
    def stop(number: int, frame: object) -> None:
        raise TimeoutError("it waits")
    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def note_readers() -> Iterator[set[str]]:
    """Functions of the package that call a guarded reader meanwhile."""
    reached: set[str] = set()

    def note(frame: Any, event: str, argument: object) -> None:
        if event != "call":
            return
        function = frame.f_locals.get("func") if frame.f_code.co_name == "helper" else None  # of a context manager
        if getattr(function, "__name__", frame.f_code.co_name) in READERS:
            while frame is not None and frame.f_code.co_name != "do":
                file = frame.f_code.co_filename
                if file.startswith(str(PACKAGE)) and not file.endswith("/files.py"):
                    reached.add(f"{Path(file).relative_to(PACKAGE).as_posix()}::{frame.f_code.co_name}")
                    return
                frame = frame.f_back

    sys.setprofile(note)
    try:
        yield reached
    finally:
        sys.setprofile(None)


def open_door(door: Door, folder: Path) -> None:
    with limit_seconds(), contextlib.suppress(EscapeError):
        door.call(folder)


def test_every_function_that_reads_files_is_behind_a_door(tmp_path: Path):
    callers = {call.place for call in list_openings() if call.is_guarded and not call.place.startswith("files.py")}
    reached: set[str] = set()
    for number, door in enumerate(DOORS.values()):
        folder = tmp_path / str(number) / "arm"
        folder.mkdir(parents=True)
        door.make(folder)
        with note_readers() as noted:
            open_door(door, folder)
        reached |= noted
    missing = sorted(callers - reached - set(OWN))
    assert not missing, f"no door of this test leads to these: {missing}"


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "file"), [
    ("archive", "x.zip"), ("recording", "x.npz"), ("run", "run/checkpoint.npz")])
def test_a_zip_of_70_000_members_is_refused_before_they_are_listed(tmp_path: Path, name: str, file: str):
    DOORS[name].make(tmp_path)
    (tmp_path / file).write_bytes(make_large_zip())
    tracemalloc.start()
    open_door(DOORS[name], tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * 2**20


@pytest.mark.filterwarnings("ignore")
@pytest.mark.nightly_for("run", "old run", "robot", "games", "comparison")
@pytest.mark.parametrize("name", DOORS)
def test_no_file_blocks_swells_or_ends_in_an_error_that_is_not_ours(tmp_path: Path, name: str):
    door = DOORS[name]
    for number, (file, plant) in enumerate((file, plant) for file in door.files for plant in PLANTS.values()):
        folder = tmp_path / str(number) / "arm"
        folder.mkdir(parents=True)
        door.make(folder)
        (folder / file).unlink(missing_ok=True)
        plant(folder / file)
        open_door(door, folder)
