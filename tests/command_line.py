"""Commands as a user runs them: in this process, in another, and as the installed program."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from hrl_escape.cli import main, run_script
from tests.forks import run_fork

PROGRAM = Path(sys.executable).with_name("hrl-escape")


def call(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command run in this process."""
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def call_script(capsys: pytest.CaptureFixture[str], module: str, *arguments: Any) -> tuple[int, str, str]:
    """The same of `python -m MODULE`."""
    code = run_script(import_module(module).run, [str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def assert_refused(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    """A mistake ends in exit code 2 and one line on stderr that has these words."""
    assert_is_refusal(call(capsys, *arguments), "hrl-escape", words)


def assert_script_refused(capsys: pytest.CaptureFixture[str], module: str, arguments: list[str], words: str) -> None:
    """The same of `python -m MODULE`."""
    assert_is_refusal(call_script(capsys, module, *arguments), f"python -m {module}", words)


def assert_is_refusal(done: tuple[int, str, str], program: str, words: str) -> None:
    code, out, err = done
    assert code == 2 and out == ""
    assert err.startswith(f"{program}: ") and err.count("\n") == 1 and words in err


def run_program(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, which has the libraries already."""
    return run_fork("import sys; from hrl_escape.cli import main; sys.exit(main())", *arguments, cwd=cwd)


def run_python(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A script in an interpreter that is started anew, where a fork would have loaded too much."""
    return subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True)


def run_here(script: str, *arguments: str) -> str:
    """What a script prints in this process, to hold against what it prints in another."""
    with patch.object(sys, "argv", ["-c", *arguments]), contextlib.redirect_stdout(io.StringIO()) as out:
        exec(script, {})
    return out.getvalue()
