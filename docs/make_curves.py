"""Make the learning curves that the agents' pages show: each agent flat and over options, in the paper's first room.

    python docs/make_curves.py          # those that are missing
    python docs/make_curves.py dqn      # one, anew

Runs are kept in runs/curves and go on where they were stopped; what the site needs of them goes to docs/curves.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hrl_escape.agents.registry import join_name, list_agents
from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.files import write_json
from hrl_escape.sets.room_spec import RoomSpec

ROOM, RUNS, PRIMITIVES, POINTS = "paper-one-button", 3, 10_000, 20
OPTIONS_ONLY = {"factored-r-max", "hrc", "met-r-max", "monte-carlo-model", "vigorito-barto"}
"""Made for options; among primitives they would plan for hours."""
CURVES = Path(__file__).parent / "curves"


def make_grid(name: str) -> Grid:
    """An agent over primitives, and over options and primitives."""
    over_options = f"{join_name(name, True)}+primitives"
    agents = (over_options,) if name in OPTIONS_ONLY else (name, over_options)
    return Grid(name=f"curve-{name}", description=f"How {name} learns.", rooms=(RoomSpec(ROOM),), runs=RUNS,
                agents=agents, primitives=PRIMITIVES,
                eval_every=PRIMITIVES // POINTS, eval_episodes=1)


def summarise(name: str, comparison: Comparison) -> dict:
    """Mean, lowest and highest return over runs, at equal distances."""
    grid = np.linspace(0, PRIMITIVES, POINTS + 1)
    curves, best = [], 0.0
    for spec in comparison.grid.agents:
        lines = []
        for run, result in comparison.runs:
            if run.agent == spec:
                points = [(e.primitives, np.mean(e.returns)) for e in result.evaluations]
                lines.append(np.interp(grid, *zip(*points, strict=True)))
                best = float(np.mean(result.score_range.reachable))
        curves.append({"agent": spec.label, "primitives": grid.tolist(),
                       **{key: np.round(of(lines, axis=0), 1).tolist()
                          for key, of in (("mean", np.mean), ("low", np.min), ("high", np.max))}})
    return {"room": ROOM, "runs": RUNS, "primitives": PRIMITIVES, "best": best, "curves": curves,
            "command": f"python docs/make_curves.py {name}"}


def main() -> None:
    """Run and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("agents", nargs="*", help="names; those without a curve by default")
    parser.add_argument("--workers", type=int, default=None, help="runs at a time; one a core by default")
    arguments = parser.parse_args()
    missing = [name for name in list_agents() if not (CURVES / f"{name}.json").is_file()]
    for name in arguments.agents or missing:
        comparison = run_grid(make_grid(name), Path("runs/curves") / name, LocalLauncher(arguments.workers))
        if comparison.failures:
            raise SystemExit(f"{name}: {comparison.failures[0].message}")
        write_json(CURVES / f"{name}.json", summarise(name, comparison))


if __name__ == "__main__":
    main()
