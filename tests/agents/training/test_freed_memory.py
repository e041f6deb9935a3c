"""Freed memory: a block as large as one that was freed costs no fresh pages."""

import platform

import pytest

from tests.forks import run_fork

COUNT_FAULTS = """
import resource, sys
import numpy as np
from hrl_escape.agents.training.many_envs import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
def touch(): np.ones(5_000_000)  # 40 MB, beyond what glibc keeps by itself
touch()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    touch()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.nightly
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's allocator is asked")
def test_kept_memory_is_used_again():
    given_back, kept = (int(run_fork(COUNT_FAULTS, how, check=True).stdout) for how in ("given back", "kept"))
    assert kept < given_back / 10
