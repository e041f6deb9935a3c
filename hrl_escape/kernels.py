"""Compiled kernels: one decorator, one cache on disk, and one clock that excludes compilation.

The key of the cache contains the package's version and the code of all kernels, without docstrings and comments. An
upgrade never loads code that an older version compiled, and all checkouts of the same code share the cache. A new cache
begins with the kernels that `hrl-escape warm` left in the virtual environment. Compilation is announced on stderr.
`read_clock` stops while numba compiles or loads a kernel, which keeps that out of every measured or limited time.
Importing this module imports numba.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numba
from numba.core import compiler, config, event
from numba.core.caching import FunctionCache, UserProvidedCacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime.nrt import rtsys

from hrl_escape.version import __version__

SOURCES = ("agents/factored/search.py", "agents/factored/structure.py", "env/bases/base.py", "env/floor_grid.py",
           "env/geometry.py", "floor/clearance.py", "floor/dijkstra.py", "floor/sweeps.py",
           "options/batched/value_iteration.py", "planning/arm/joint_lattice.py", "planning/search/a_star.py")
"""Files, relative to the package, that compiled code depends on: functions, constants and tuple types.

The files of single bases are not among them: their code is in the names of the types that kernels are compiled for, see
`floor/sweeps.py`.
"""

INSTALLED = Path(sys.prefix, "share", "hrl_escape")
"""Kernels that were compiled for this installation, in a folder with the name of the cache's folder."""
_PROSE = re.compile(rb"""
    ^[ \t]*\"{3}[\s\S]*?\"{3}                              # a docstring, or the description of an attribute
    | [ \t]*\#.*                                           # a comment
    | ("(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*')          # any other text, which can contain a # of its own
    """, re.MULTILINE | re.VERBOSE)
_PARTS = {"agents": "structure learning", "env": "the room's geometry", "floor": "ways over the floor",
          "options": "options in batches", "planning.arm": "the arm", "planning": "the planner's search"}
"""Purpose of the kernels of each part of the package, for the progress line."""
_CONFIG: Any = config  # numba sets its attributes at import


class _PartLibrary(JITCodeLibrary):
    """Intermediate code of a function that only other compiled code calls.

    The kernels that contain it are optimised and turned into machine code; numba would do both for each function, too.
    """

    @property
    def codegen(self) -> Any:
        """Nothing that could be called, and thus takes no environment."""
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        """Leave out the environment, which a kernel from the cache has not either for its parts."""

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function of CPython that raises `TypeError`, for calls from Python."""
        super().get_pointer_to_function(name)
        return ctypes.cast(ctypes.pythonapi.PyErr_BadArgument, ctypes.c_void_p).value or 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class _PartCompiler(compiler.Compiler):
    """Compiles into a `_PartLibrary`."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *values: Any) -> None:
        super().__init__(typingctx, targetctx, library or _PartLibrary(targetctx.codegen(), "part"), *values)


_COUNTED: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Numba's options for code that is called from Python, and from C by nobody."""
_UNCOUNTED: dict[str, Any] = {**_COUNTED, "_nrt": False}
"""Numba's options for code without its runtime, which allocates arrays and counts references to them."""
PART: Any = {**_UNCOUNTED, "no_cpython_wrapper": True, "pipeline_class": _PartCompiler}
"""Numba's options for code that only other compiled code calls."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at first use and cache it on disk."""
    return _compile(function, _COUNTED)


def kernel_in_place(function: Callable[..., Any]) -> Any:
    """Compile a function that neither allocates nor returns an array; see `kernel`.

    Numba then omits reference counts of its array arguments. With many arrays in a tuple it would count at every use of
    the tuple, which took two thirds of the time of A*.
    """
    return _compile(function, _UNCOUNTED)


class SourceLocator(UserProvidedCacheLocator):
    """Location of a kernel's compiled code, by its place in the package, wherever the package is installed."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the module's folder within the package, or a hash of the whole path for other files."""
        folder = Path(py_file).resolve().parent
        package = Path(__file__).resolve().parent
        if not folder.is_relative_to(package):
            return super().get_suitable_cache_subpath(py_file)
        return "-".join(folder.relative_to(package.parent).parts)

    def get_source_stamp(self) -> Any:
        """Return a constant for files of the package, whose code is part of the folder's name."""
        return "" if self._is_own() else super().get_source_stamp()

    def get_disambiguator(self) -> str:
        """Return a constant for files of the package, whose line numbers change with docstrings."""
        return "" if self._is_own() else super().get_disambiguator()

    def _is_own(self) -> bool:
        return Path(self._py_file).resolve() in {Path(__file__).resolve().parent / name for name in SOURCES}


class _KernelCache(FunctionCache):
    """Compiled code of a kernel on disk.

    Numba loads all that it knows of NumPy before it looks into the cache, and SciPy's linear algebra with it: a fifth
    of a first plan. Compiled code needs numba's runtime, and the secret of Python's hashes, alone.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for argument types, None if the cache has none."""
        importlib.import_module("numba.cpython.hashing")
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def _compile(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    compiled = numba.njit(**options)(function)
    before = _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES
    try:  # only a new cache reads both
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = str(_FOLDER), f"{__name__}.{SourceLocator.__name__}"
        vars(compiled)["_cache"] = _KernelCache(function)
    finally:
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = before
    _USES[function.__qualname__] = next(
        (use for part, use in _PARTS.items() if f"hrl_escape.{part}" in function.__module__), "your own code")
    return compiled


def kernel_part(function: Callable[..., Any]) -> Any:
    """Compile a function that neither allocates nor returns an array, as part of the kernels that call it.

    Only they can call it; from Python it raises `TypeError`.
    """
    return numba.njit(**PART)(function)


def find_cache_folder() -> Path:
    """Return the folder of compiled kernels; the variable NUMBA_CACHE_DIR moves it."""
    return make_cache_folder(f"{__version__}-{hash_code(Path(__file__).parent / name for name in SOURCES)}")


def hash_code(files: Iterable[Path]) -> str:
    """Return 12 hexadecimal digits that change with the code of modules, but not with docstrings and comments."""
    sources = hashlib.sha256()
    for file in files:
        sources.update(strip_prose(file.read_bytes()))
    return sources.hexdigest()[:12]


def make_cache_folder(name: str) -> Path:
    """Return a folder of the package's cache on disk, made if it is missing; NUMBA_CACHE_DIR moves the cache."""
    chosen = _CONFIG.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for base in (Path(chosen).expanduser(), Path(tempfile.gettempdir()) / f"cache-{os.getuid()}"):
        folder = base / "hrl_escape" / name
        try:
            if not folder.exists():
                _begin_cache(folder)
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="hrl_escape-"))


def keep_in_installation() -> bool:
    """Copy all kernels into the virtual environment, and return whether it worked. New caches begin with them."""
    if sys.prefix == sys.base_prefix:
        return False
    shutil.rmtree(INSTALLED, ignore_errors=True)
    _copy_whole(_FOLDER, INSTALLED / _FOLDER.name)
    return (INSTALLED / _FOLDER.name).is_dir()


def _begin_cache(folder: Path) -> None:
    """Copy the kernels of the installation into a new cache; one that NUMBA_CACHE_DIR names begins empty."""
    if not _CONFIG.CACHE_DIR and (INSTALLED / folder.name).is_dir():
        _copy_whole(INSTALLED / folder.name, folder)


def _copy_whole(source: Path, target: Path) -> None:
    """Copy a folder, if that is possible and no other process is first. No reader ever sees a part of it."""
    with contextlib.suppress(OSError):  # no space, or no right to write there
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
            shutil.copytree(source, Path(scratch, "copy")).rename(target)


def strip_prose(source: bytes) -> bytes:
    """Return a module's code without docstrings, comments and empty lines."""
    lines = _PROSE.sub(lambda found: found[1] or b"", source).splitlines()
    return b"\n".join(line for line in lines if line.strip())


def read_clock() -> float:
    """Return the seconds of a clock that stops while this thread compiles or loads kernels."""
    return time.perf_counter() - _STOPWATCH.read()


class _Stopwatch(event.Listener):
    """Time that each thread has spent compiling and loading."""

    def __init__(self) -> None:
        self._thread = threading.local()

    def read(self) -> float:
        """Return the seconds of the current thread."""
        spent = getattr(self._thread, "spent", 0.0)
        return spent + (time.perf_counter() - self._thread.began if getattr(self._thread, "depth", 0) else 0.0)

    def on_start(self, event: Any) -> None:
        """Record the beginning of the outermost event."""
        depth = getattr(self._thread, "depth", 0)
        if depth == 0:
            self._thread.began = time.perf_counter()
        self._thread.depth = depth + 1

    def on_end(self, event: Any) -> None:
        """Add the duration of the outermost event."""
        self._thread.depth -= 1
        if self._thread.depth == 0:
            self._thread.spent = getattr(self._thread, "spent", 0.0) + time.perf_counter() - self._thread.began


class _Announcer(event.Listener):
    """Announces on stderr that kernels are being compiled, and their purpose."""

    def __init__(self) -> None:
        self._count, self._uses = 0, set[str]()

    def on_start(self, event: Any) -> None:
        """Announce the first kernel of each purpose; on a terminal, name every kernel."""
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
        """Clear the line."""
        if _get_name(event) in _USES and sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _get_name(happened: event.Event) -> str:
    dispatcher = (happened.data or {}).get("dispatcher")
    return dispatcher.py_func.__qualname__ if dispatcher is not None else ""


_USES: dict[str, str] = {}
_FOLDER = find_cache_folder()
_STOPWATCH = _Stopwatch()
event.register("numba:compiler_lock", _STOPWATCH)
event.register("numba:compile", _Announcer())
