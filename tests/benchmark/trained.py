"""A small benchmark, and an agent trained on it."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from hrl_escape.agents.spec import OptionsView
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_archive import AgentCard, RoomView
from hrl_escape.benchmark.replay import make_view_env
from hrl_escape.sets.benchmark import Benchmark
from hrl_escape.sets.rung import Rung
from tests.sets.small import make_manifest

CARD = {"name": "mine", "authors": ["Somebody"]}


@cache
def make_bench() -> Benchmark:
    return Benchmark(make_manifest())


def get_rung() -> Rung:
    return make_bench()["one"]


def make_card(**fields: Any) -> AgentCard:
    rung = get_rung()
    return AgentCard.from_dict({**CARD, "agent": "smdp-q-learning", "benchmark": rung.benchmark, "rung": rung.name,
                                "root": rung.record.test.root, "rooms": 1, **fields})


def train_once(out: Path) -> Path:
    """A training run of a few episodes in the rung's rooms."""
    view = RoomView("features", options=OptionsView(include_primitives=False))
    env, _ = make_view_env(view, get_rung().train)
    train("smdp-q-learning", env, primitives=300, eval_every=150, eval_episodes=1, out=out, progress=False,
          observed=False)
    env.close()
    return out
