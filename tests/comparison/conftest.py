"""The small comparison, run once for all tests that only read it."""

from __future__ import annotations

import pytest

from hrl_escape.comparison.comparison import Comparison
from tests.comparison.small import SMALL, run_quietly


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    return run_quietly(SMALL, tmp_path_factory.mktemp("small"))
