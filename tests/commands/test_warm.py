"""Kernels that are compiled ahead of the first plan."""

import os

import pytest

from tests.forks import run_fork

SOLVE = "from hrl_escape.cli import main\nmain(['solve', '--room', 'clutter'])"


@pytest.mark.slow
def test_after_it_a_plan_compiles_nothing(tmp_path):
    own = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    run_fork("from hrl_escape.cli import main\nmain(['warm', '--jobs', '2'])", check=True, environment=own)
    assert "compiling" not in run_fork(SOLVE, check=True, environment=own).stderr
