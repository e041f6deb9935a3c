"""What all benchmarks share: the list of them, their help, and one line for a mistake."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from tests.command_line import call_script

ROOT = Path(__file__).parents[2]
RUNNABLE = ("agents", "batch", "env", "modes", "planners")


def test_all_benchmarks_are_listed_with_one_line_each(capsys):
    main()
    listed = dict(re.findall(r"^  (\w+) +(\S.*)$", capsys.readouterr().out, re.MULTILINE))
    assert set(RUNNABLE) <= set(listed) and "machine" not in listed


@pytest.mark.parametrize("name", RUNNABLE)
def test_a_benchmark_explains_itself_and_every_option(capsys, name):
    code, out, _ = call_script(capsys, f"benchmarks.{name}", "--help")
    assert code == 0 and f"usage: python -m benchmarks.{name}" in out
    for option in re.findall(r"^│ (--[a-z-]+)", out, re.MULTILINE):
        after = out.split(option, 1)[1].split("│ --", 1)[0]
        assert re.search(r"[a-z]{3,}", after), f"{option} has no help"


SCRIPTS = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if path.stem != "__main__" and
                 '__name__ == "__main__"' in path.read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_every_benchmark_prints_its_help_and_exits(name):
    done = subprocess.run([sys.executable, "-m", f"benchmarks.{name}", "--help"], cwd=ROOT, capture_output=True,
                          text=True, timeout=120, stdin=subprocess.DEVNULL)
    if done.returncode != 0:
        assert done.stdout == "" and done.stderr.count("\n") == 1 and "pip install" in done.stderr
    assert "usage" in done.stdout or "pip install" in done.stderr


@pytest.mark.nightly
def test_a_mistake_in_a_process_of_its_own_is_one_line_and_exit_code_2():
    done = subprocess.run([sys.executable, "-m", "benchmarks.env", "--presets", "cluter"], cwd=ROOT,
                          capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("python -m benchmarks.env: ") and done.stderr.count("\n") == 1


def test_modes_measures_the_view_beside_the_headless_room(capsys):
    code, out, _ = call_script(capsys, "benchmarks.modes", "--repeats", "1", "--seconds", "0.05")
    assert code == 0
    for mode in ("headless, primitives", "headless, meta-actions", "real-time view", "published code"):
        assert re.search(rf"{mode} +[\d,.]+ +[\d,.]+ +[\d,.]+", out)
