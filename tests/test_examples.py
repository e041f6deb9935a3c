"""Every example runs from a checkout and shows what its lesson says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.forks import run_file

EXAMPLES = Path(__file__).parents[1] / "examples"

# script, arguments that make it quick, and what its output must show
LESSONS = [
    ("door_1_flat.py", ["--primitives", "1500"],
     [r"6 primitives: forward, back", r"1,500 random primitives: \d+ presses"]),
    ("door_2_options.py", [],
     [r"press-button-1: \d+ primitives, reached, .*pressed \['button-1'\]", r"escaped: True, return \d+"]),
    ("door_3_training.py", ["--agent", "random-options+primitives", "--primitives", "500"],
     [r"  0 primitives: return", r"  5\d\d primitives: return", r"press-button-\d: \d+ primitives, reward -\d+"]),
    ("door_4_planner.py", ["--room", "paper-two-button", "--draw", "plan.svg"],
     [r"total +\d+", r"driven: escaped True.*every state as predicted: True"]),
    ("stable_baselines.py", ["--steps", "256"],
     [r"DQN on primitives", r"MaskablePPO on options: 256 steps, then return",
      r"PPO as the option balance: \d+ primitives, reward \d+, ended by (reached|episode-over)"]),
    ("continuous_sac.py", ["--steps", "150"],
     [r"plan: escaped in \d+\.\d s of motion", r"SAC, 150 steps: return -?\d+\.\d in \d+\.\d s"]),
    ("cleanrl_ppo.py", ["--primitives", "4096"], [r"4,096 primitives: return -?\d+, \d+% of \d+ episodes escape"]),
    ("pufferlib_ppo.py", ["--primitives", "4096"],
     [r"PufferLib is not installed|\d,\d\d\d primitives: return -?\d+, \d+% of \d+ episodes escape"]),
    ("tianshou_dqn.py", [], [r"Tianshou is not installed|1,000 decisions: return \d+"]),
    ("torchrl_macros.py", [],
     [r"transform: 8 rewards, sum -17\.122;", r"'brake': 0", r"macro: 8 primitives, reached, sum -17\.122,.*\^k 0\.430",
      r"brake: \d+ primitives, reached", r"brake: cannot start here"]),
    ("own_agent.py", ["--primitives", "1000"], [r"return -1000 untrained, -?\d+ after 1,\d\d\d primitives"]),
    ("own_option.py", [], [r"slide-\w+: \d+ primitives, reached"]),
    ("own_option_set.py", [], [r"press-button-1: \d+ primitives, reached", r"go-home: \d+ primitives, reached",
                               r"option_set=press-or-go-home\) chooses among press-or-go-home"]),
    ("own_reward.py", [], [r"one room: \[-1.0, -1.5\]", r"a batch:  \[\[-1.0, -1.0\], \[-1.5, -1.5\]\]"]),
    ("own_puzzle.py", ["--count", "3"], [r"press-light-2 ", r"total +\d+ .*return [5-9]\d"]),
    ("own_robot.py", [], [r"flange within (0e\+00|\de-1\d) m", r"[1-9]\d* postures reach", r"through \d+ postures"]),
    ("narrow_passage.py", [], [r"escape in \d\d primitives; at [1-9]\d* of", r"escaped True.*as predicted: True"]),
    ("smallest_puzzle.py", [], [r"press-b ", r"total +\d+ .*return [1-9]\d"]),
    ("tools_trl.py", [], [r"You drive a robot", r"over: escaped", r"reward (0\.[5-9]\d|1\.00)"]),
    ("tools_balrog.py", [], [r"The puzzle: ", r"over: escaped", r"'progression': 1\.0, 'failed_candidates': \['ask"]),
    ("tools_openenv.py", [], [r"OpenEnv is not installed|escaped\. \d+\.0 True"]),
    ("compare_with_sb3.py", ["--primitives", "600", "--seeds", "1", "--out", "out"],
     [r"PPO of SB3: efficiency \d\.\d\d", r"PPO over options: efficiency \d\.\d\d .*decisions",
      r"curve: out/curve\.svg, report: out/report\.html"]),
    ("tools_textarena.py", [], [r"Options: press-button-1", r"over: escaped", r"\{0: 0\.\d+\}|\(\{0: 0\.\d+"]),
    ("tools_verifiers.py", [], [r"verifiers is not installed"]),
    ("own_comparison.py", ["--primitives", "2", "--runs", "1", "--out", "out"],
     [r"headline: ", r"caution: One run a room", r"report: out/report.html"]),
]


FAST = ("door_1_flat.py", "door_2_options.py", "door_3_training.py", "door_4_planner.py", "own_option.py",
        "own_reward.py", "smallest_puzzle.py", "tools_balrog.py")
"""The others run nightly: they take longer, or use a package that may be missing."""
LEARNED = [("cleanrl_ppo.py", ["--primitives", "24576"],
            [r"24,576 primitives: return (8[5-9]|9\d), 100% of \d+ episodes escape"]),
           ("own_agent.py", ["--primitives", "4000"], [r"return -1000 untrained, [3-9]\d after 4,0\d\d primitives"])]


@pytest.mark.parametrize(("script", "arguments", "shows"), [
    *(pytest.param(*lesson, id=lesson[0], marks=() if lesson[0] in FAST else pytest.mark.nightly)
      for lesson in LESSONS),
    *(pytest.param(*lesson, id=f"{lesson[0]} to the end", marks=pytest.mark.nightly) for lesson in LEARNED)])
def test_example(script: str, arguments: list[str], shows: list[str], tmp_path: Path):
    done = run_file(EXAMPLES / script, *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for pattern in shows:
        assert re.search(pattern, done.stdout), f"{pattern!r} is not in\n{done.stdout}"
    for name in arguments:
        if name.endswith(".svg"):
            assert (tmp_path / name).read_bytes().startswith(b"<?xml")


def test_every_example_is_tested_and_listed():
    scripts = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert scripts == sorted(lesson[0] for lesson in LESSONS)
    assert re.findall(r"^\| \[(\w+\.py)\]\(\1\)", (EXAMPLES / "README.md").read_text(), re.MULTILINE) == [
        lesson[0] for lesson in LESSONS]


def test_the_own_agent_is_as_short_as_it_says():
    """Forty lines of code in the class: no blank lines, no docstrings."""
    import ast

    source = (EXAMPLES / "own_agent.py").read_text()
    (agent,) = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef) and node.name == "MonteCarlo"]
    lines = {number for node in ast.walk(agent) if hasattr(node, "lineno") and not isinstance(node, ast.ClassDef)
             for number in range(node.lineno, node.lineno + 1)}
    documents = {node.lineno for node in ast.walk(agent)
                 if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)}
    assert len(lines - documents) <= 40
