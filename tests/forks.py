"""Scripts in processes of their own, forked from one that has loaded the libraries once.

A fork is like a new interpreter that has the libraries and nothing of this package, with arguments, working folder,
environment and standard streams of its own. All workers of a test run share one server; it starts with the first
fork and ends with the run. What is said of an interpreter's beginning (what an import loads, a hash seed)
needs an interpreter that is started anew.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import gc
import importlib
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
import types
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

__all__ = ["RUN", "run_file", "run_fork", "run_module"]

LIBRARIES = ("numba", "torch", "torchrl", "tensordict", "pybullet", "ompl", "pinocchio", "scipy.optimize",
             "scipy.stats", "gymnasium", "pytest", "matplotlib.pyplot", "hypothesis", "jinja2", "rich.table", "tyro",
             "viser", "PIL.Image", "importlinter.cli")
RUN = "HRL_ESCAPE_TEST_RUN"
"""Variable that holds the process id of the test run, in all its processes."""


def run_fork(script: str, *arguments: object, cwd: Path | None = None, environment: Mapping[str, str] | None = None,
             input: str = "", timeout: float | None = None, processor_seconds: int | None = None,
             check: bool = False) -> subprocess.CompletedProcess[str]:
    """Run a script as `python -c` would.

    Args:
        script: the program.
        arguments: follow its name in `sys.argv`.
        cwd: its working folder; that of this process by default.
        environment: all its environment; that of this process by default.
        input: what it reads from stdin.
        timeout: seconds after which it is killed.
        processor_seconds: processor time after which it is killed, by SIGXCPU.
        check: any return code but 0 is an error.

    Raises:
        subprocess.CalledProcessError: it failed, with `check`.
        subprocess.TimeoutExpired: it was killed.
    """
    words = ["-c", *map(str, arguments)]
    request = {"script": script, "arguments": words, "cwd": str(cwd or Path.cwd()),
               "processor_seconds": processor_seconds,
               "environment": dict(os.environ if environment is None else environment)}
    (out, to_out), (err, to_err) = os.pipe(), os.pipe()
    with (_connect() as server, server.makefile("rw") as lines, tempfile.TemporaryFile() as stdin,
          open(out, "rb") as stdout, open(err, "rb") as stderr, ThreadPoolExecutor() as pool):
        stdin.write(input.encode())
        stdin.seek(0)
        socket.send_fds(server, [b"fork"], [stdin.fileno(), to_out, to_err])
        os.close(to_out)
        os.close(to_err)
        said = [pool.submit(stream.read) for stream in (stdout, stderr)]
        print(json.dumps(request), file=lines, flush=True)
        pid = int(lines.readline())
        server.settimeout(timeout)
        try:
            code = int(lines.readline())
        except TimeoutError:
            os.kill(pid, signal.SIGKILL)
            raise subprocess.TimeoutExpired(words, timeout or 0.0) from None
        done = subprocess.CompletedProcess(words, code, *(each.result().decode() for each in said))
    if check and code != 0:
        raise subprocess.CalledProcessError(code, words, done.stdout, done.stderr)
    return done


def run_file(path: Path, *arguments: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """Run a file as `python PATH` would; settings as of `run_fork`."""
    script = ("import runpy, sys; path = sys.argv.pop(1); sys.argv[0] = path; sys.path[0] = path.rpartition('/')[0]\n"
              "runpy.run_path(path, run_name='__main__')")
    return run_fork(script, path, *arguments, **settings)


def run_module(name: str, *arguments: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """Run a module as `python -m NAME` would; settings as of `run_fork`."""
    script = "import runpy, sys; runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
    return run_fork(script, name, *arguments, **settings)


def _connect() -> socket.socket:
    """A connection to the server of this test run, which the first caller starts."""
    run = os.environ.setdefault(RUN, str(os.getpid()))
    address = f"{tempfile.gettempdir()}/forks-{os.getuid()}-{run}"
    server = socket.socket(socket.AF_UNIX)
    with open(f"{address}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            server.connect(address)
        except (FileNotFoundError, ConnectionRefusedError):
            environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
            subprocess.run([sys.executable, __file__, address, run], env=environment, cwd="/", check=True,
                           stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
            server.connect(address)
    return server


# --- the server, which runs as a program ---------------------------------------------------------


def serve(address: str, run: int) -> None:
    """Load the libraries, then fork for every connection until the test run has ended."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    target = importlib.import_module("numba.core.registry").cpu_target
    for tables in (target.typing_context, target.target_context):  # which the first kernel would build in every fork
        tables.refresh()
    gc.freeze()  # no fork walks through what all of them share, which would copy its pages too
    with contextlib.suppress(FileNotFoundError):
        os.unlink(address)
    server = socket.socket(socket.AF_UNIX)
    server.bind(address)
    server.listen(64)
    if os.fork():
        os._exit(0)  # whoever started this process goes on: the server is ready
    os.setsid()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    server.settimeout(2.0)
    while _is_alive(run):
        with contextlib.suppress(TimeoutError):
            connection, _ = server.accept()
            if os.fork() == 0:
                _answer(connection)
            connection.close()
    for name in (address, f"{address}.lock"):
        os.unlink(name)
    os._exit(0)  # libraries that are taken apart while frozen tell of leaks


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _answer(connection: socket.socket) -> NoReturn:
    """Run what a connection asks for in a fork, and send its process id and its return code, each a line."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    connection.settimeout(None)
    _, streams, _, _ = socket.recv_fds(connection, 4, 3)
    lines = connection.makefile("rw")
    request = json.loads(lines.readline())
    pid = os.fork()
    if pid == 0:
        _become(request, streams)
    for stream in streams:
        os.close(stream)
    with contextlib.suppress(BrokenPipeError):  # of a caller that has stopped waiting
        print(pid, file=lines, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), file=lines, flush=True)
    os._exit(0)


def _become(request: dict[str, Any], streams: list[int]) -> NoReturn:
    """Be the process that runs a script."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    os.chdir(request["cwd"])
    tempfile.tempdir = None  # read from the environment anew
    os.environ.clear()
    os.environ.update(request["environment"])
    if request["processor_seconds"]:
        resource.setrlimit(resource.RLIMIT_CPU, (request["processor_seconds"], resource.RLIM_INFINITY))
    sys.modules["numba"].config.reload_config()  # reads the environment
    sys.argv = request["arguments"]
    sys.path[:1] = ["", *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    importlib.invalidate_caches()
    module = sys.modules["__main__"] = types.ModuleType("__main__")
    code = 0
    try:
        exec(compile(request["script"], "<string>", "exec"), module.__dict__)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
        code = 1
    with contextlib.suppress(BaseException):
        threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as an interpreter does that ends
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]))
