"""Train the agents that come with the package, and test them in their rooms.

    python -m benchmarks.pretrained                         # all, some minutes, into the package
    python -m benchmarks.pretrained marks-4/rules --out agents

On rungs that teach across rooms an agent learns from many rooms at once and is tested in every test room; on the others
it learns the first test room from nothing. A file is a submission, which `hrl-escape ladder verify-submission` plays
again; the record of one that was tested in every room stands on the board.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from hrl_escape.agents import train
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.protocols import LadderSettings, make_protocol_grid
from hrl_escape.benchmark.runs import get_training_folder
from hrl_escape.benchmark.submission import Card, describe_score, pack_submission
from hrl_escape.sets import load_benchmark
from studies.unseen import make_streams

READER = "smdp-ppo+objects+memory"
STREAMS, TRAIN_ROOMS, READ, EVALUATIONS = 256, 1000, 2_000_000, 10
"""Of a reader of marks: rooms at once, training rooms, primitives and evaluations."""
READ_RUNGS = ("marks-2/motifs", "marks-3/deceived", "marks-3/places")
ON_DEMAND = ("marks-4/rules", "marks-4/wires")
"""Rungs whose readers stand on the board and are made when asked for: agents in the package stay below 4 MB."""
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


def train_reader(place: str, primitives: int, out: Path) -> Path:
    """Train on many rooms of a rung at once; returns the run's folder."""
    spec = AgentSpec.parse(READER)
    train(spec, make_streams(*place.split("/"), TRAIN_ROOMS, STREAMS, READER), primitives=primitives,
          eval_every=primitives // EVALUATIONS, eval_episodes=10, out=out / "run")
    return out / "run"


def train_learner(agent: str, place: str, primitives: int, out: Path) -> Path:
    """Train in the first test room of a rung; returns the run's folder."""
    benchmark, name = place.split("/")
    grid = make_protocol_grid(load_benchmark(benchmark), name, "per-instance", [AgentSpec.parse(agent)],
                              LadderSettings(runs=1, primitives=primitives, rooms=1, eval_episodes=5))
    comparison = run_grid(grid, out)
    (run, _), = comparison.runs
    return get_training_folder(out, run)


def make(place: str, out: Path, primitives: int | None = None, rooms: int | None = None) -> None:
    """Train for a rung, and write the submission."""
    benchmark, name = place.split("/")
    rung, reads = load_benchmark(benchmark)[name], place in (*READ_RUNGS, *ON_DEMAND)
    agent, budget = (READER, READ) if reads else LEARNED[name]
    primitives = primitives or budget
    with tempfile.TemporaryDirectory() as made:
        if reads:
            run = train_reader(place, primitives, Path(made))
            command = f"python -m benchmarks.pretrained {place}, which trains {agent}"
        else:
            run = train_learner(agent, place, primitives, Path(made))
            command = (f"hrl-escape ladder run {agent} --benchmark {benchmark} --rung {name} --protocol per-instance "
                       f"--rooms 1 --runs 1 --primitives {primitives} --eval-episodes 5")
        card = Card.from_dict({"name": agent, "authors": ["hrl-escape"], "told": "nothing", "training": command})
        path = out / place / f"{agent}.zip"
        path.parent.mkdir(parents=True, exist_ok=True)
        packed = pack_submission(path, rung, card, str(run), Path(), rooms if reads else 1)
        print(f"{place}: {describe_score(packed, rung)}")


def main() -> None:
    """Make those that are asked for."""
    every = [*READ_RUNGS, *(f"ladder-1/{name}" for name in LEARNED)]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rungs", nargs="*", default=every, choices=[*every, *ON_DEMAND, []], help="benchmark and rung")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder, by default the package's")
    parser.add_argument("--primitives", type=int, help="in place of the rung's own budget")
    parser.add_argument("--rooms", type=int, help="test rooms of those that read marks; all by default")
    arguments = parser.parse_args()
    for place in arguments.rungs:
        make(place, arguments.out, arguments.primitives, arguments.rooms)


if __name__ == "__main__":
    main()
