"""Hold agents made of TorchRL's parts against this project's own, at equal settings: returns, and updates a second.

    python -m benchmarks.torchrl_controls
    python -m benchmarks.torchrl_controls --runs 2 --primitives 1000

Runs alternate in one process on one thread. An update is a step of Adam; its time is the time of `observe` with replay
and advantages, in seconds of processor time.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy import stats
from torch.optim.optimizer import register_optimizer_step_post_hook

from hrl_escape.agents import make_agent, train
from hrl_escape.agents.registry import get_agent_class
from hrl_escape.options import OptionsEnv
from hrl_escape.options.options_env import make_options_env

CONTROLS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "dqn": ({"n_step": 1, "average_rate": 0.0}, {}),
    "ppo": ({}, {"value_weight": 0.25}),  # of the whole squared error, where ours weighs half of it
}
"""Remaining differences after fields of one name are set equal: of this project's agent, and of TorchRL's."""


class Outcome(NamedTuple):
    """A run.

    Attributes:
        final: mean return of the last evaluation.
        updates: steps of Adam.
        learning: seconds of them.
    """

    final: float
    updates: int
    learning: float


def choose_settings(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of both: this project's defaults, as far as both have a field of that name."""
    ours, theirs = (get_agent_class(prefix + name).Settings for prefix in ("", "torchrl-"))
    names = {field.name for field in dataclasses.fields(theirs)} & {field.name for field in dataclasses.fields(ours)}
    shared = {field.name: field.default for field in dataclasses.fields(ours) if field.name in names}
    return shared | CONTROLS[name][0], shared | CONTROLS[name][1]


def run_once(name: str, settings: dict[str, Any], room: str, primitives: int, seed: int) -> Outcome:
    """Train over planned options."""
    env: OptionsEnv = make_options_env(room, observation="features", include_primitives=False)
    agent = make_agent(name, env.observation_space, env.action_space, seed, **settings)
    observe, count, learning = agent.observe, 0, 0.0

    def observe_timed(transition: Any) -> Any:
        nonlocal learning
        started, before = time.process_time(), count
        told = observe(transition)
        if count > before:
            learning += time.process_time() - started
        return told

    def note(*_: Any) -> None:
        nonlocal count
        count += 1

    agent.observe = observe_timed  # type: ignore[method-assign]  # timed for this run
    hook = register_optimizer_step_post_hook(note)
    try:
        result = train(agent, env, primitives=primitives, seed=seed, eval_every=primitives, eval_episodes=5,
                       progress=False)
    finally:
        hook.remove()
        env.close()
    return Outcome(float(np.mean(result.evaluations[-1].returns)), count, learning)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each agent."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", default="paper-two-button")
    parser.add_argument("--primitives", type=int, default=6_000)
    parser.add_argument("--runs", type=int, default=10)
    chosen = parser.parse_args(arguments)
    torch.set_num_threads(1)
    print("| agent | return at the end, mean (95 %) | updates a run | updates a second | of its control |\n"
          "|---|---|---|---|---|")
    for name in CONTROLS:
        outcomes: dict[str, list[Outcome]] = {name: [], f"torchrl-{name}": []}
        for seed in range(chosen.runs):
            for agent, settings in zip(outcomes, choose_settings(name), strict=True):
                outcomes[agent].append(run_once(agent, settings, chosen.room, chosen.primitives, seed))
        rates = {agent: np.float64(sum(run.updates for run in runs)) / sum(run.learning for run in runs)
                 for agent, runs in outcomes.items()}
        for agent, runs in outcomes.items():
            finals = np.array([run.final for run in runs])
            half = stats.t.ppf(0.975, len(runs) - 1) * finals.std(ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else 0
            print(f"| `smdp-{agent}` | {finals.mean():.1f} ({finals.mean() - half:.1f} to {finals.mean() + half:.1f}) "
                  f"| {np.mean([run.updates for run in runs]):,.0f} | {rates[agent]:,.0f} "
                  f"| {rates[agent] / rates[name]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
