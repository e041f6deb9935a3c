"""Nightly checks of libraries in environments of their own, and of Gymnasium's suite over this package's ids."""

from __future__ import annotations

import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from benchmarks import gymnasium_suite, third_party


@pytest.mark.slow
@pytest.mark.parametrize("name", third_party.LIBRARIES)
def test_a_library_reads_masks_and_durations_in_an_environment_of_its_own(name, tmp_path):
    if sys.version_info < (3, 11):
        pytest.skip("Tianshou 2 needs Python 3.11")
    try:
        urllib.request.urlopen("https://pypi.org/simple/pip/", timeout=30).close()
    except OSError as error:
        pytest.skip(f"no package index: {error}")
    done = third_party.run_apart(name, tmp_path / name)
    assert done.returncode == 0, done.stdout
    assert re.search(rf"^{name}: \S", done.stdout, re.MULTILINE)


def test_unknown_libraries_are_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        third_party.main(["tianshu"])
    assert "no such library: tianshu. Known: tianshou, rllib" in capsys.readouterr().err


SUITE = """
import gymnasium
import pytest
from tests.envs.utils import all_testing_env_specs, all_testing_initialised_envs

NAMES = [spec.id for spec in all_testing_env_specs]


@pytest.mark.parametrize("spec", all_testing_env_specs, ids=NAMES)
def test_reset(spec):
    assert spec.make().reset(seed=0)[1]["is_success"] is (spec.id == "hrl_escape/PaperTwoButton-v1"), "as planted"


def test_envs():
    assert [env.spec.id for env in all_testing_initialised_envs] == NAMES
    assert gymnasium.__file__ != "planted"
"""


@pytest.mark.nightly
def test_the_suite_of_a_checkout_runs_over_our_ids_and_reports_each_failure(tmp_path):
    envs = tmp_path / "tests/envs"
    envs.mkdir(parents=True)
    for folder in (envs, envs.parent):
        (folder / "__init__.py").touch()
    (envs / "utils.py").write_text("all_testing_env_specs, all_testing_initialised_envs = [], []\n")
    (envs / "test_envs.py").write_text(SUITE)
    (tmp_path / "gymnasium").mkdir()
    (tmp_path / "gymnasium/__init__.py").write_text("__file__ = 'planted'\n")
    done = subprocess.run([sys.executable, "-m", "benchmarks.gymnasium_suite", tmp_path, "--ids", "PaperTwoButton"],
                          cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert done.returncode == 1, done.stdout + done.stderr
    assert re.search(r"test_reset: 1 of 2 ids fail\n  hrl_escape/PaperTwoButton-v1: .*as planted", done.stdout)
    assert "2 ids, 3 tests passed, 1 failed" in done.stdout


def test_a_folder_without_the_suite_is_refused(capsys, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        gymnasium_suite.main([str(tmp_path)])
    assert "has no tests/envs/test_envs.py: give a checkout of github.com/" in capsys.readouterr().err
