"""Gymnasium's own test suite, run over the ids that this package registers, from a checkout of its repository.

    git clone https://github.com/Farama-Foundation/Gymnasium             # and check out the release that is installed
    python -m benchmarks.gymnasium_suite Gymnasium                       # some five minutes
    python -m benchmarks.gymnasium_suite Gymnasium --ids PaperTwoButton Taxi

`tests/envs/test_envs.py` checks the API, the passive checker, determinism and pickling. It is not copied here.
Gymnasium itself is the installed one. Where an id has wrappers, such as options, `check_env` also checks it with them.
Exits with 1 if a test fails.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import OrderEnforcing, TimeLimit

import hrl_escape  # noqa: F401  # registers the environments

SUITE = "tests/envs/test_envs.py"
WRAPPED = "different from the unwrapped version"
"""In the warning of `check_env` for an environment with wrappers, which is meant here."""


class Failures:
    """Plugin of pytest that collects failures: the last line of each by test, then id."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, str]] = defaultdict(dict)
        self.passed = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a finished test."""
        name, _, identity = report.nodeid.rpartition("::")[2].partition("[")
        if report.failed:
            crash = getattr(report.longrepr, "reprcrash", None)
            self.found[name][identity.rstrip("]")] = str(crash.message if crash else report.longrepr).splitlines()[0]
        self.passed += report.when == "call" and report.passed


def list_ids(words: Sequence[str]) -> list[str]:
    """Ids of this package that contain any of the words; all of them without words."""
    return [name for name in gymnasium.registry if name.startswith("hrl_escape/")
            and (not words or any(word in name for word in words))]


def run_suite(checkout: Path, ids: Sequence[str]) -> Failures:
    """Run the suite in this process.

    Args:
        checkout: of Gymnasium's repository.
        ids: to run it over.
    """
    root = str(Path(__file__).parents[1])
    sys.path[:] = [str(checkout), *(place for place in sys.path if place not in ("", root))]
    os.chdir(checkout)
    utils: Any = __import__("tests.envs.utils", fromlist=["utils"])
    utils.all_testing_env_specs[:] = [gymnasium.spec(name) for name in ids]
    utils.all_testing_initialised_envs[:] = [gymnasium.spec(name).make(disable_env_checker=True) for name in ids]
    failures = Failures()
    pytest.main([SUITE, "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts="],
                plugins=[failures])
    return failures


def check_with_wrappers(ids: Sequence[str], failures: Failures) -> None:
    """Let `check_env` check the ids that have wrappers, with them; failures are added to those found."""
    for name in ids:
        env: gymnasium.Env = gymnasium.make(name, disable_env_checker=True)
        while isinstance(env, (OrderEnforcing, TimeLimit)):
            env = env.env
        if env is env.unwrapped:
            continue
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                check_env(env, skip_render_check=True)
            if told := [str(each.message) for each in caught if WRAPPED not in str(each.message)]:
                failures.found["check_env with wrappers"][name] = told[0]
            else:
                failures.passed += 1
        except Exception as error:
            failures.found["check_env with wrappers"][name] = str(error).splitlines()[0]
        env.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where a test fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="folder of a checkout of Gymnasium's repository")
    parser.add_argument("--ids", nargs="*", default=(), help="words, one of them required in an id")
    chosen = parser.parse_args(arguments)
    if not (chosen.checkout / SUITE).is_file():
        parser.error(f"{chosen.checkout} has no {SUITE}: give a checkout of github.com/Farama-Foundation/Gymnasium")
    ids = list_ids(chosen.ids)
    failures = run_suite(chosen.checkout.resolve(), ids)
    check_with_wrappers(ids, failures)
    for test, found in failures.found.items():
        print(f"\n{test}: {len(found)} of {len(ids)} ids fail")
        for name, reason in found.items():
            print(f"  {name}: {reason[:300]}")
    count = sum(map(len, failures.found.values()))
    print(f"\n{len(ids)} ids, {failures.passed} tests passed, {count} failed")
    return 1 if count or not failures.passed else 0


if __name__ == "__main__":
    sys.exit(main())
