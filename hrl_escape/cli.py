"""The command line `hrl-escape`: finds the commands in `hrl_escape/commands` and runs the one that is asked for.

A command is a function of a module there, `run` for the module's own name or `run_NAME`, and a folder is a group of
commands. `run_script` gives a single module, such as a benchmark, the same front.

Help is read from the files without importing them, and only the command that runs is
imported: help is quick, and a missing optional package stops no other command. What the
user did wrong is one line on stderr and exit code 2, never a traceback.
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

    It is 0 for success, 2 for a mistake of the user's or output that cannot be written, 128 and the signal's number if
    a signal or a closed pipe ended it.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order(_PROGRAM, lambda: _run(words, _FOLDER, _COMMANDS, [_PROGRAM]))


def run_script(run: Callable[..., int | None], arguments: Sequence[str] | None = None) -> int:
    """Run a module's `run` as `python -m MODULE`: its options, help and errors are made as those of `hrl-escape` are.

    It takes one dataclass of options; its module's docstring is the help. Returns the exit code, as `main`.
    """
    spec = sys.modules[run.__module__].__spec__
    words = ["python", "-m", spec.name if spec else run.__module__]
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order(" ".join(words), lambda: _run_command(run, given, words))


def run_in_order(program: str, work: Callable[[], int]) -> int:
    """Exit code of the work; what stops it is said in one line."""
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
    except BrokenPipeError:  # whoever read our output has seen enough
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
    except SystemExit as exit_:  # tyro has printed help, or what is wrong with the arguments
        if isinstance(exit_.__context__, BrokenPipeError):  # rich's answer to a closed pipe
            return 128 + signal.SIGPIPE
        return exit_.code if isinstance(exit_.code, int) else 0 if exit_.code is None else 2


@contextmanager
def _raising_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP unwind the program as Ctrl-C does, so that folders and processes are left in order."""
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
    """Refuse a NUMBA_NUM_THREADS at which numba fails to import."""
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if re.fullmatch("0*[1-9][0-9]{0,3}", threads) is None:
        raise ConfigError("NUMBA_NUM_THREADS", threads, "a whole number from 1 to 9999, or leave it unset")


def _drop_output() -> None:
    """Discard output that cannot be written, which Python would try to write once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(program: str, message: str, code: int) -> int:
    """Say in one line why the program ends; returns the exit code."""
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
    import tyro  # not for `hrl-escape --help`

    args_type = typing.get_type_hints(run)["args"]
    if hasattr(args_type, "check_words"):
        args_type.check_words(words, arguments)
    document = sys.modules[run.__module__].__doc__ if run.__name__ == "run" else inspect.getdoc(run)
    args = tyro.cli(args_type, prog=" ".join(words), args=arguments, description=document,
                    config=(tyro.conf.FlagCreatePairsOff,))
    return run(args) or 0


def find_commands(folder: Path) -> dict[str, tuple[Path, str]]:
    """Commands and groups in a folder by name: the module and function of each, or a group's folder and no function."""
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
