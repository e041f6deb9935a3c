"""Train the agents that come with the package, and test them in their rooms.

    python -m benchmarks.pretrained                         # all, some minutes, into the package
    python -m benchmarks.pretrained chain --out agents

Each learns the first test room of its rung from nothing. A file is an archive of `hrl_escape.benchmark.agent_archive`.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.leaderboard.results import pack
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.agent_archive import describe_score
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.protocols import LadderSettings, make_protocol_grid
from hrl_escape.benchmark.run_results import get_training_folder
from hrl_escape.sets import load_benchmark

TABLE, MODEL, STRUCTURE, THREE = (f"smdp-{name}" for name in (
    "q-learning", "r-max", "factored-r-max", "factored-r-max@three-parents"))
LEARNED = {
    **dict.fromkeys(("doormat", "pair", "chain-3", "doors"), (TABLE, 20_000)),
    **dict.fromkeys(("code", "freight", "switchboard"), (MODEL, 10_000)),
    **dict.fromkeys(("chain-4", "chain", "clutter", "drift", "lattice-5", "lattice-6", "lattice-7", "lattice",
                     "reach"), (STRUCTURE, 4_000)),
    "lattice-8": (THREE, 4_000), "house": (THREE, 10_000)}
"""Rungs of `ladder-1`: who learns the first test room, and primitives; models keep all that they have met."""
FOLDER = Path(__file__).parents[1] / "hrl_escape/benchmark/data/pretrained"


def train_learner(agent: str, place: str, primitives: int, out: Path) -> Path:
    """Train in the first test room of a rung; returns the run's folder."""
    benchmark, name = place.split("/")
    grid = make_protocol_grid(load_benchmark(benchmark), name, "per-instance", [AgentSpec.parse(agent)],
                              LadderSettings(runs=1, primitives=primitives, rooms=1, eval_episodes=5))
    comparison = run_grid(grid, out)
    (run, _), = comparison.runs
    return get_training_folder(out, run)


def make(name: str, out: Path, primitives: int | None = None) -> None:
    """Train for a rung of `ladder-1`, and write the archive."""
    place, rung, (agent, budget) = f"ladder-1/{name}", load_benchmark("ladder-1")[name], LEARNED[name]
    primitives = primitives or budget
    with tempfile.TemporaryDirectory() as made:
        run = train_learner(agent, place, primitives, Path(made))
        command = (f"hrl-escape ladder run {agent} --benchmark ladder-1 --rung {name} --protocol per-instance "
                   f"--rooms 1 --runs 1 --primitives {primitives} --eval-episodes 5")
        card = {"name": agent, "authors": ["hrl-escape"], "training": command}
        path = out / place / f"{agent}.zip"
        path.parent.mkdir(parents=True, exist_ok=True)
        packed = pack(path, rung, card, run, 1)
        print(f"{place}: {describe_score(packed.results, rung)}")


def main() -> None:
    """Make those that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rungs", nargs="*", default=list(LEARNED), choices=[*LEARNED, []], help="rungs of ladder-1")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder, by default the package's")
    parser.add_argument("--primitives", type=int, help="in place of the rung's own budget")
    arguments = parser.parse_args()
    for name in arguments.rungs:
        make(name, arguments.out, arguments.primitives)


if __name__ == "__main__":
    main()
