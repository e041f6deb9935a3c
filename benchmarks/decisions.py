"""Measure decisions per second of `dqn` and `ppo`, in one environment and in many.

A decision is a choice, its observation and the updates that follow. Observations have 12 numbers and come from a random
generator, so that the agents take nearly all of the time. One CPU core is used, and CPU seconds are counted, so that
other work on the machine hardly changes the numbers. Agents take turns; the best of the rounds is printed.

Examples:
    python -m benchmarks.decisions
    python -m benchmarks.decisions --agents dqn sarsa --rounds 5
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents import SMDPTransition, make_agent
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.single_env import serve_many, serve_one
from hrl_escape.cli import run_script

INPUTS, ACTIONS = 12, 9
SPACES = gymnasium.spaces.Box(-1, 1, (INPUTS,), np.float32), gymnasium.spaces.Discrete(ACTIONS)
DECISIONS = {1: 2_000, 64: 12_800, 4_096: 262_144}
"""Decisions that are measured, by the number of environments."""


@dataclass(frozen=True)
class Args:
    """What to measure."""

    agents: Annotated[tuple[str, ...], tyro.conf.arg(help="names of agents")] = ("dqn", "ppo")
    rounds: Annotated[int, tyro.conf.arg(help="turns of each agent")] = 3


def measure_one(name: str, decisions: int) -> float:
    """Decisions per CPU second in one environment."""
    rng, agent = np.random.default_rng(0), make_agent(name, *SPACES, 0)
    served, mask = serve_one(agent), np.ones(ACTIONS, np.bool_)
    seen, over = rng.standard_normal((decisions + 1, INPUTS)).astype(np.float32), rng.random(decisions) < 0.02
    begun = time.process_time()
    for before, after, ends in zip(seen, seen[1:], over.tolist(), strict=False):
        action = served.act(before, mask)
        served.observe(SMDPTransition(before, action, mask, -1.0, -1.0, 1, 0.99, after, mask, ends, False))
    return decisions / (time.process_time() - begun)


def measure_many(name: str, count: int, decisions: int) -> float:
    """Decisions per CPU second in many environments that step together."""
    generator, agent = torch.Generator().manual_seed(0), make_agent(name, *SPACES, 0)
    served = serve_many(agent)
    served.begin_episodes(count, torch.device("cpu"))
    env, mask = torch.arange(count), torch.ones((count, ACTIONS), dtype=torch.bool)
    paid, k, no = -torch.ones(count), torch.ones(count, dtype=torch.int64), torch.zeros(count, dtype=torch.bool)
    steps = max(decisions // count, 1)
    seen = torch.randn((steps + 1, count, INPUTS), generator=generator)
    over = torch.rand((steps, count), generator=generator) < 0.02
    begun = time.process_time()
    for before, after, ends in zip(seen, seen[1:], over, strict=False):
        action = served.act(Moments(env, before, mask))
        served.observe(Decisions(env, before, mask, action, paid, paid, k, -0.99 * paid, after, mask, ends, no))
    return steps * count / (time.process_time() - begun)


def measure(args: Args) -> dict[tuple[str, int], float]:
    """Decisions per CPU second of each agent at each number of environments."""
    best: dict[tuple[str, int], float] = {}
    for _ in range(args.rounds):
        for count, decisions in DECISIONS.items():
            for name in args.agents:
                rate = measure_one(name, decisions) if count == 1 else measure_many(name, count, decisions)
                best[name, count] = max(best.get((name, count), 0.0), rate)
    return best


def run(args: Args) -> None:
    """Measure and print."""
    torch.set_num_threads(1)
    best = measure(args)
    table = Table("agent", *(f"n = {count:,}" for count in DECISIONS), title="decisions per CPU second")
    for name in args.agents:
        rates: Any = (f"{best[name, count]:,.0f}" for count in DECISIONS)
        table.add_row(name, *rates)
    Console().print(table)


if __name__ == "__main__":
    sys.exit(run_script(run))
