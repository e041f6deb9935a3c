"""A benchmark of quick rooms, a trained agent, and cards, for submissions."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

from hrl_escape.agents.spec import OptionsView
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.submission import Card, RoomView, make_view_env
from hrl_escape.sets.benchmark import Benchmark
from hrl_escape.sets.rung import Rung
from tests.sets.small import make_manifest

ROUND = 7


@cache
def make_bench() -> Benchmark:
    """The small benchmark, with a round of the beacon announced."""
    return Benchmark(dataclasses.replace(make_manifest(), hidden_round=ROUND))


def get_rung() -> Rung:
    return make_bench()["one"]


def make_card(**fields) -> Card:
    return Card.from_dict({"name": "mine", "authors": ["Somebody"], "told": "nothing", **fields})


def make_program(folder: Path, code: str, **fields) -> Card:
    """A program of one file."""
    folder.mkdir(exist_ok=True)
    (folder / "agent.py").write_text(code)
    return make_card(command=["python", "agent.py"], files=["agent.py"], **fields)


def train_once(out: Path) -> Path:
    """A training run of a few episodes in the rung's rooms."""
    view = RoomView("features", options=OptionsView(include_primitives=False))
    env, _ = make_view_env(view, get_rung().train)
    train("smdp-q-learning", env, primitives=300, eval_every=150, eval_episodes=1, out=out, progress=False,
          observed=False)
    env.close()
    return out
