"""Importing the engine: pybullet's banner is dropped, and nothing else that is written to stderr."""

import os

import pytest

from hrl_escape.env import bullet
from tests.command_line import run_python


@pytest.mark.nightly
def test_importing_an_engine_module_writes_nothing():
    done = run_python("import hrl_escape.env.bullet.engine")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_only_lines_with_the_given_start_are_dropped(capfd):
    with bullet._drop_stderr_lines(b"noise"):
        os.write(2, b"noise: 1\nwarning: noise\nnoise: 2\n")
    os.write(2, b"noise: afterwards\n")
    assert capfd.readouterr().err == "warning: noise\nnoise: afterwards\n"


@pytest.mark.nightly
def test_the_engine_imports_with_stderr_closed():
    done = run_python("import os; os.close(2); import hrl_escape.env.bullet.engine; print('imported')")
    assert done.stdout == "imported\n"
