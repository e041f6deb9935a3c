"""Train the agents that come with the package, each from many rooms at once, and test them in every test room.

    python -m benchmarks.pretrained                         # all, some minutes each, into the package
    python -m benchmarks.pretrained marks-2/motifs --out /tmp/agents

A file is a submission, which `hrl-escape ladder verify-submission` plays again; its record stands on the board.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from hrl_escape.agents import train
from hrl_escape.comparison.board.board import describe_score
from hrl_escape.comparison.board.play import pack_submission
from hrl_escape.comparison.board.submission import Card
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.ladder import load_benchmark
from studies.unseen import make_streams

AGENT = "smdp-ppo+objects+memory+no-primitives"
STREAMS, EVALUATIONS = 256, 10
TRAINED = {"marks-2/motifs": (1000, 2_000_000), "marks-3/deceived": (1000, 2_000_000),
           "marks-3/places": (1000, 2_000_000)}
"""Rung -> training rooms and primitives."""
FOLDER = Path(__file__).parents[1] / "hrl_escape/ladder/data/pretrained"


def make(place: str, out: Path, size: int, primitives: int, rooms: int | None = None) -> None:
    """Train in so many of a rung's training rooms, and write the submission."""
    benchmark, _, name = place.partition("/")
    rung, spec = load_benchmark(benchmark)[name], AgentSpec.parse(AGENT)
    with tempfile.TemporaryDirectory() as made:
        train(spec.name, make_streams(benchmark, name, size, STREAMS), primitives=primitives, settings=spec.settings,
              eval_every=primitives // EVALUATIONS, eval_episodes=10, out=made)
        card = Card.from_dict({"name": AGENT, "authors": ["hrl-escape"], "told": "nothing",
                               "training": f"python -m benchmarks.pretrained {place} ({AGENT})"})
        path = out / place / f"{AGENT}.zip"
        path.parent.mkdir(parents=True, exist_ok=True)
        print(f"{place}: {describe_score(pack_submission(path, rung, card, made, Path(), rooms), rung)}")


def main() -> None:
    """Make those that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rungs", nargs="*", default=list(TRAINED), help="benchmark and rung")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder, by default the package's")
    parser.add_argument("--primitives", type=int, help="in place of the rung's own budget")
    parser.add_argument("--rooms", type=int, help="test rooms; all by default")
    arguments = parser.parse_args()
    for place in arguments.rungs:
        size, primitives = TRAINED[place]
        make(place, arguments.out, size, arguments.primitives or primitives, arguments.rooms)


if __name__ == "__main__":
    main()
