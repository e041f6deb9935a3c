"""The command line `hrl-escape`: finds the commands in `hrl_escape/commands` and runs the requested one.

A command is a function of a module there: `run` for the module's own name, or `run_NAME`. A folder is a group of
commands. `run_script` gives a single module, such as a benchmark, the same interface.

Help is read from the files without importing them, and only the requested command is imported. Help is therefore fast,
and a missing optional package affects only the commands that need it. Mistakes of the user are reported in one line on
stderr with exit code 2, without a traceback.
"""

from __future__ import annotations

import ast
import errno
import inspect
import os
import re
import signal
import sys
import threading
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from hrl_escape import __version__
from hrl_escape.errors import ConfigError, EscapeError, UnknownNameError
from hrl_escape.signals import Ended, end_by_signal

_PROGRAM = "hrl-escape"
_COMMANDS = "hrl_escape.commands"
_FOLDER = Path(__file__).parent / "commands"
_UNWRITABLE_OUTPUT = (errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EDQUOT)
_IMPOSSIBLE_PATH = (errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENOTDIR, errno.EROFS)
_HELP, _VERSION = ("-h", "--help", "help"), ("--version", "-V")
_RUNS = re.compile(r"^def (run(?:_\w+)?)\(args", re.MULTILINE)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default this process's, and return the exit code.

    The code is 0 for success, 2 for a mistake of the user or output that cannot be written, and 128 plus the signal's
    number if a signal or a closed pipe ended the command.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order(_PROGRAM, lambda: _run(words, _FOLDER, _COMMANDS, [_PROGRAM]))


def run_script(run: Callable[..., int | None], arguments: Sequence[str] | None = None) -> int:
    """Run a module's `run` as `python -m MODULE`, with the options, help and errors of `hrl-escape`.

    `run` takes one dataclass of options; the docstring of its module is the help. Returns the exit code, like `main`.
    """
    spec = sys.modules[run.__module__].__spec__
    words = ["python", "-m", spec.name if spec else run.__module__]
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order(" ".join(words), lambda: _run_command(run, given, words))


def run_in_order(program: str, work: Callable[[], int]) -> int:
    """Run the work and return its exit code; report in one line what stops it."""
    try:
        with _raising_signals():
            _check_threads()
            code = work()
            if sys.stdout is not None:
                sys.stdout.flush()
            return code
    except Ended as ended:
        return _report(program, f"ended by {signal.Signals(ended.number).name}", 128 + ended.number)
    except KeyboardInterrupt as stop:
        return _report(program, str(stop) or "interrupted", 128 + signal.SIGINT)
    except BrokenPipeError:  # the reader of our output has closed it
        _drop_output()
        return 128 + signal.SIGPIPE
    except EscapeError as error:
        return _report(program, " ".join(str(error).splitlines()), 2)
    except OSError as error:
        if error.filename is not None and error.errno in _IMPOSSIBLE_PATH:
            return _report(program, f"{str(error.filename)[:200]}: {error.strerror}", 2)
        if error.filename is not None or error.errno not in _UNWRITABLE_OUTPUT:
            raise
        _drop_output()
        return _report(program, f"cannot write the output: {error.strerror}", 2)
    except SystemExit as exit_:  # tyro has printed help, or an error in the arguments
        if isinstance(exit_.__context__, BrokenPipeError):  # rich exits this way after a closed pipe
            return 128 + signal.SIGPIPE
        return exit_.code if isinstance(exit_.code, int) else 0 if exit_.code is None else 2


@contextmanager
def _raising_signals() -> Iterator[None]:
    """Make SIGTERM and SIGHUP unwind the program as Ctrl-C does, which cleans up folders and processes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) is signal.SIG_DFL]
    for number in asked:
        signal.signal(number, end_by_signal)
    try:
        yield
    finally:
        for number in asked:
            signal.signal(number, signal.SIG_DFL)


def _check_threads() -> None:
    """Refuse values of NUMBA_NUM_THREADS that make numba's import fail."""
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if re.fullmatch("0*[1-9][0-9]{0,3}", threads) is None:
        raise ConfigError("NUMBA_NUM_THREADS", threads, "a whole number from 1 to 9999, or unset")


def _drop_output() -> None:
    """Discard output that cannot be written; Python would otherwise try again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(program: str, message: str, code: int) -> int:
    """Print in one line why the program ends; return the exit code."""
    print(f"{program}: {message}", file=sys.stderr)
    return code


def _run(arguments: list[str], folder: Path, package: str, words: list[str]) -> int:
    commands = find_commands(folder)
    verb = arguments[0] if arguments else _HELP[0]
    if verb in _VERSION and words == [_PROGRAM]:
        print(f"{_PROGRAM} {__version__}")
        return 0
    if verb in _HELP:
        print(_format_help(commands, folder, words))
        return 0 if arguments else 2
    if verb not in commands:
        raise UnknownNameError(f"command {' '.join([*words[1:], ''])}".rstrip(), verb, commands)
    path, function = commands[verb]
    name = f"{package}.{path.stem}"
    if not function:
        return _run(arguments[1:], path, name, [*words, verb])
    return _run_command(getattr(import_module(name), function), arguments[1:], [*words, verb])


def _run_command(run: Callable[..., int | None], arguments: list[str], words: list[str]) -> int:
    import tyro  # imported here because `hrl-escape --help` does not need it

    args_type = typing.get_type_hints(run)["args"]
    if hasattr(args_type, "check_words"):
        args_type.check_words(words, arguments)
    document = sys.modules[run.__module__].__doc__ if run.__name__ == "run" else inspect.getdoc(run)
    args = tyro.cli(args_type, prog=" ".join(words), args=arguments, description=document,
                    config=(tyro.conf.FlagCreatePairsOff,))
    return run(args) or 0


def find_commands(folder: Path) -> dict[str, tuple[Path, str]]:
    """Return commands and groups in a folder by name: (module, function) of a command, (folder, "") of a group."""
    found = {}
    for path in folder.iterdir():
        if (path / "__init__.py").is_file():
            found[path.stem] = path, ""
        elif path.suffix == ".py":
            for function in _RUNS.findall(path.read_text(encoding="utf-8")):
                verb = function.removeprefix("run_") if function != "run" else path.stem
                found[verb.replace("_", "-")] = path, function
    return dict(sorted(found.items()))


def _summarise(path: Path, function: str = "") -> str:
    """First line of the docstring of a command or a group."""
    file = path / "__init__.py" if path.is_dir() else path
    module = ast.parse(file.read_text(encoding="utf-8"))
    inner = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == function]
    return (ast.get_docstring(module if function in ("", "run") else inner[0]) or "").splitlines()[0]


def _format_help(commands: dict[str, tuple[Path, str]], folder: Path, words: list[str]) -> str:
    width = max(map(len, commands), default=0)
    lines = [f"  {verb:<{width}}  {_summarise(*found)}" for verb, found in commands.items()]
    about = (f"{_PROGRAM} {__version__}: escape rooms for hierarchical reinforcement learning." if words == [_PROGRAM]
             else _summarise(folder))
    usage = f"usage: {' '.join(words)} COMMAND [OPTIONS]"
    more = f"`{' '.join(words)} COMMAND --help` explains a command and its options."
    return "\n".join([about, "", usage, "", *lines, "", more])


if __name__ == "__main__":
    sys.exit(main())
