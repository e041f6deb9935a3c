"""Two buttons, 20,000 primitives, ten seeds: do agents over options reach a score of 0.95, and what do others do?

Run: `python benchmarks/two_button.py` (about four minutes on two cores); the report is in `runs/two-button`. Exits
with 1 if smdp-dqn+primitives or smdp-q-learning+primitives falls short. Flat agents and the random policies are only
reported.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.presets import get_grid
from hrl_escape.benchmark.reporting.report import write_report

NEEDED = {"smdp-dqn+primitives": 0.95, "smdp-q-learning+primitives": 0.95}


def main() -> int:
    """Run what is not finished, print the table, and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/two-button"))
    parser.add_argument("--workers", type=int, default=None, help="one a core by default")
    arguments = parser.parse_args()
    grid = dataclasses.replace(get_grid("quickstart"), name="two-button", runs=10, primitives=20_000)
    comparison = run_grid(grid, arguments.out, LocalLauncher(arguments.workers))
    summary = write_report(comparison, "python benchmarks/two_button.py")
    short = []
    for agent in summary.agents:
        needed = NEEDED.get(agent.label, 0.0)
        score = agent.score
        print(f"{agent.label:16} IQM {score.value:.3f} ({score.low:.3f} to {score.high:.3f}), escapes "
              f"{agent.success.value:.0%}, {agent.length.value:.0f} primitives", f"(needs {needed})" if needed else "")
        short += [agent.label] if agent.score.value < needed else []
    return 1 if short or comparison.failures else 0


if __name__ == "__main__":
    sys.exit(main())
