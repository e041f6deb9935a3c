"""Kernels that are compiled ahead of the first plan."""

import os

import pytest

from tests.forks import run_fork

MAIN = "import sys\nsys.prefix = {prefix!r}\nfrom hrl_escape.cli import main\nmain({arguments!r})"
"""A command in another virtual environment, as far as its kernels go."""


@pytest.mark.slow
def test_after_it_a_plan_compiles_nothing_with_a_new_cache_either(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}

    def run_command(cache: str, *arguments: str) -> str:
        code = MAIN.format(prefix=str(tmp_path), arguments=list(arguments))
        return run_fork(code, check=True, environment=environment | {"XDG_CACHE_HOME": str(tmp_path / cache)}).stderr

    assert "compiling" in run_command("first", "warm", "--jobs", "2")
    assert "compiling" not in run_command("first", "solve", "--room", "clutter")
    assert "compiling" not in run_command("second", "solve", "--room", "clutter")
