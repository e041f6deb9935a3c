"""Compiled kernels: one decorator, one cache on disk, one clock that leaves compilation out.

The cache is keyed by the package's version and by the sources of all kernels: an upgrade never meets what an older
version compiled, and all checkouts of the same sources share it. Compilation is announced on stderr. `read_clock`
stands still while numba compiles or loads a kernel: no measured or limited time contains that. Importing this
module imports numba.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numba
from numba.core import config, event
from numba.core.caching import UserProvidedCacheLocator

from hrl_escape.version import __version__

SOURCES = ("agents/factored/search.py", "agents/factored/structure.py", "env/bases/__init__.py", "env/bases/base.py",
           "env/bases/disc.py", "env/bases/rectangle.py", "env/floor_grid.py", "env/geometry.py", "floor/clearance.py",
           "floor/dijkstra.py", "floor/sweeps.py", "options/batched/value_iteration.py",
           "planning/arm/joint_lattice.py", "planning/search/a_star.py")
"""Files, relative to the package, that compiled code is made of: functions, constants and the tuples it is given."""
WITHOUT_BASES = ("agents/factored/search.py", "agents/factored/structure.py", "planning/arm/joint_lattice.py")
"""Those of `SOURCES` whose kernels contain no function of a base, so a new base leaves what is compiled valid."""

_PARTS = {"agents": "learners of structure", "env": "the room's geometry", "floor": "ways over the floor",
          "options": "options in batches", "planning.arm": "the arm", "planning": "the planner's search"}
"""Purpose of the kernels of each part of the package, for the progress line."""
_CONFIG: Any = config  # its names are set when it is imported
_UNCOUNTED: dict[str, Any] = {"_nrt": False}
"""Numba's option for code without its runtime, which allocates arrays and counts references to them."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on first use and keep it on disk."""
    return _compile(function, {})


def kernel_in_place(function: Callable[..., Any]) -> Any:
    """Compile a function that makes and returns no array; see `kernel`.

    Numba then leaves out the counts of references to the arrays that it is given. With many arrays in a tuple it
    counts at every use of the tuple: that took two thirds of the time of A*.
    """
    return _compile(function, _UNCOUNTED)


class SourceLocator(UserProvidedCacheLocator):
    """Place of a kernel's compiled code: by its place in the package, wherever the package is."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """The module's folder within the package; a hash of the whole path for other files."""
        folder = Path(py_file).resolve().parent
        package = Path(__file__).resolve().parent
        if not folder.is_relative_to(package):
            return super().get_suitable_cache_subpath(py_file)
        return "-".join(folder.relative_to(package.parent).parts)


def _compile(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    before = _CONFIG.CACHE_DIR, getattr(_CONFIG, "CACHE_LOCATOR_CLASSES", "")
    try:  # both are read by the decorator only; numba before 0.62 knows one locator
        folder = _FOLDER_WITHOUT_BASES if function.__module__ in _MODULES_WITHOUT_BASES else _FOLDER
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = str(folder), f"{__name__}.{SourceLocator.__name__}"
        compiled = numba.njit(cache=True, **options)(function)
    finally:
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = before
    _USES[function.__qualname__] = next(
        (use for part, use in _PARTS.items() if f"hrl_escape.{part}" in function.__module__), "your own code")
    return compiled


def kernel_part(function: Callable[..., Any]) -> Any:
    """Compile a function that makes and returns no array, as part of the kernels that call it."""
    return numba.njit(**_UNCOUNTED)(function)


def add_sources(files: Iterable[Path]) -> None:
    """Keep the kernels with bases that are decorated from now on apart from those that other files are part of."""
    global _FOLDER
    own = {Path(__file__).parent / name for name in SOURCES}
    foreign = [file for file in files if file not in own]
    if foreign:
        _FOLDER = find_cache_folder(foreign)


def find_cache_folder(more: Iterable[Path] = (), own: Iterable[str] | None = None) -> Path:
    """Folder of compiled kernels; the variable NUMBA_CACHE_DIR moves it.

    Args:
        more: files that are part of the kernels besides the package's own.
        own: the package's own files, `SOURCES` by default.
    """
    package = Path(__file__).parent
    sources = hashlib.sha256()
    for file in (*(package / name for name in (SOURCES if own is None else own)), *more):
        sources.update(file.read_bytes())
    folder = f"{__version__}-{sources.hexdigest()[:12]}"
    chosen = _CONFIG.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for base in (Path(chosen).expanduser(), Path(tempfile.gettempdir()) / f"cache-{os.getuid()}"):
        try:
            (base / "hrl_escape" / folder).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(base / "hrl_escape" / folder, os.W_OK):
            return base / "hrl_escape" / folder
    return Path(tempfile.mkdtemp(prefix="hrl_escape-"))


def read_clock() -> float:
    """Seconds of a clock that stands still while this thread compiles or loads kernels."""
    return time.perf_counter() - _STOPWATCH.read()


class _Stopwatch(event.Listener):
    """Time that each thread has spent compiling and loading."""

    def __init__(self) -> None:
        self._thread = threading.local()

    def read(self) -> float:
        """Seconds of the present thread so far."""
        spent = getattr(self._thread, "spent", 0.0)
        return spent + (time.perf_counter() - self._thread.began if getattr(self._thread, "depth", 0) else 0.0)

    def on_start(self, event: Any) -> None:
        """Note the beginning of the outermost event."""
        depth = getattr(self._thread, "depth", 0)
        if depth == 0:
            self._thread.began = time.perf_counter()
        self._thread.depth = depth + 1

    def on_end(self, event: Any) -> None:
        """Add up at the end of the outermost event."""
        self._thread.depth -= 1
        if self._thread.depth == 0:
            self._thread.spent = getattr(self._thread, "spent", 0.0) + time.perf_counter() - self._thread.began


class _Announcer(event.Listener):
    """Says on stderr that kernels are compiled, and what for."""

    def __init__(self) -> None:
        self._count, self._uses = 0, set[str]()

    def on_start(self, event: Any) -> None:
        """Announce the first kernel of each use; on a terminal, name all."""
        name = _get_name(event)
        if name not in _USES:
            return
        if (use := _USES[name]) not in self._uses:
            self._uses.add(use)
            print(f"hrl_escape: compiling kernels for {use}, once for this version; each takes a few seconds",
                  file=sys.stderr, flush=True)
        self._count += 1
        if sys.stderr.isatty():
            print(f"\r\033[K  {self._count}: {name}", end="", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Clear the line again."""
        if _get_name(event) in _USES and sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _get_name(happened: event.Event) -> str:
    dispatcher = (happened.data or {}).get("dispatcher")
    return dispatcher.py_func.__qualname__ if dispatcher is not None else ""


_USES: dict[str, str] = {}
_FOLDER, _FOLDER_WITHOUT_BASES = find_cache_folder(), find_cache_folder(own=WITHOUT_BASES)
_MODULES_WITHOUT_BASES = {f"hrl_escape.{name.removesuffix('.py').replace('/', '.')}" for name in WITHOUT_BASES}
_STOPWATCH = _Stopwatch()
event.register("numba:compiler_lock", _STOPWATCH)
event.register("numba:compile", _Announcer())
