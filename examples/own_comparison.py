"""Your own comparison in Python: a grid of agents and rooms, parallel runs that can be resumed, and a report.

On the command line: hrl-escape compare --agents random-options smdp-q-learning --room four-button-chain
"""

from pathlib import Path

import tyro

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.reporting.report import write_report
from hrl_escape.benchmark.verdict import write_verdict


def main(primitives: int = 5_000, runs: int = 4, out: Path = Path("runs/own-comparison")) -> None:
    """Compare agents that choose among options only with agents that also choose primitives.

    Args:
        primitives: training budget of a run.
        runs: number of training seeds.
        out: folder of runs and report; finished runs are reused.
    """
    grid = Grid(
        name="own-comparison",
        description="Does it help to leave the primitives out of the choices?",
        agents=(
            "random-options",
            "random-options+primitives",
            "smdp-q-learning",
            "smdp-q-learning+primitives",
        ),
        rooms=("paper-two-button", "four-button-chain"),
        runs=runs,
        primitives=primitives,
        eval_every=primitives // 2,
        eval_episodes=2,
    )
    summary = write_report(run_grid(grid, out), f"python examples/own_comparison.py --primitives {primitives}")
    for sentence in write_verdict(summary):
        print(f"{sentence.kind}: {sentence.text}")
    print(f"report: {out / 'report.html'}")


if __name__ == "__main__":  # required, because the runs start processes that import this file
    tyro.cli(main)
