"""The command line `hrl-escape`: finds the commands in `hrl_escape/commands` and runs the one that is asked for.

Help is read from the files without importing them, and only the command that runs is
imported: help is quick, and a missing optional package stops no other command. What the
user did wrong is one line on stderr and exit code 2, never a traceback.
"""

from __future__ import annotations

import ast
import os
import sys
import tempfile
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from hrl_escape import __version__
from hrl_escape.errors import EscapeError, UnknownNameError

__all__ = ["main"]

_PROGRAM = "hrl-escape"
_COMMANDS = "hrl_escape.commands"
_FOLDER = Path(__file__).parent / "commands"
_HELP, _VERSION = ("-h", "--help", "help"), ("--version", "-V")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line.

    Args:
        arguments: what follows the program's name; None takes this process's.

    Returns:
        The exit code: 0 for success, 2 for a mistake of the user's, 130 if interrupted.
    """
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments), _FOLDER, _COMMANDS, [_PROGRAM])
    except EscapeError as error:
        print(f"{_PROGRAM}: {' '.join(str(error).splitlines())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{_PROGRAM}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except SystemExit as exit_:  # tyro has printed help, or what is wrong with the arguments
        return exit_.code if isinstance(exit_.code, int) else 0 if exit_.code is None else 2


def _run(arguments: list[str], folder: Path, package: str, words: list[str]) -> int:
    commands = _find_commands(folder)
    verb = arguments[0] if arguments else _HELP[0]
    if verb in _VERSION and words == [_PROGRAM]:
        print(f"{_PROGRAM} {__version__}")
        return 0
    if verb in _HELP:
        print(_format_help(commands, folder, words))
        return 0 if arguments else 2
    if verb not in commands:
        raise UnknownNameError(f"command {' '.join([*words[1:], ''])}".rstrip(), verb, commands)
    name = f"{package}.{commands[verb].stem}"
    if commands[verb].is_dir():
        return _run(arguments[1:], commands[verb], name, [*words, verb])
    with _without_banner():
        command = import_module(name)
    return _run_command(command.run, arguments[1:], [*words, verb])


@contextmanager
def _without_banner() -> Iterator[None]:
    """Keep the line that pybullet's C code writes to stderr when it is imported from the user's eyes."""
    sys.stderr.flush()
    terminal = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(terminal, 2)
            os.close(terminal)
            said.seek(0)
            os.write(2, b"".join(line for line in said if not line.startswith(b"pybullet build time")))


def _run_command(run: Callable[..., int | None], arguments: list[str], words: list[str]) -> int:
    import tyro  # not for `hrl-escape --help`

    args_type = typing.get_type_hints(run)["args"]
    document = sys.modules[run.__module__].__doc__
    args = tyro.cli(args_type, prog=" ".join(words), args=arguments, description=document,
                    config=(tyro.conf.FlagCreatePairsOff,))
    return run(args) or 0


def _find_commands(folder: Path) -> dict[str, Path]:
    """Names of the commands and groups in a folder, and where they are."""
    found = {}
    for path in sorted(folder.iterdir()):
        is_group = (path / "__init__.py").is_file()
        if is_group or (path.suffix == ".py" and _has_run(path)):
            found[path.stem.replace("_", "-")] = path
    return found


def _has_run(path: Path) -> bool:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(part, ast.FunctionDef) and part.name == "run" for part in body)


def _get_document(path: Path) -> str:
    file = path / "__init__.py" if path.is_dir() else path
    return ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""


def _format_help(commands: dict[str, Path], folder: Path, words: list[str]) -> str:
    width = max(map(len, commands), default=0)
    lines = [f"  {verb:<{width}}  {_get_document(path).splitlines()[0]}" for verb, path in commands.items()]
    about = (f"{_PROGRAM} {__version__}: escape rooms for hierarchical reinforcement learning." if words == [_PROGRAM]
             else _get_document(folder).splitlines()[0])
    usage = f"usage: {' '.join(words)} COMMAND [OPTIONS]"
    more = f"`{' '.join(words)} COMMAND --help` explains a command and its options."
    return "\n".join([about, "", usage, "", *lines, "", more])


if __name__ == "__main__":
    sys.exit(main())
