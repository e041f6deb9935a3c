"""Frozen policies that fail although training episodes escape: are they caught in a cycle of choices?

    python -m benchmarks.frozen_policies --room clutter --primitives 50000 --seeds 2

Trains `smdp-dqn+primitives`, at its defaults and at those before them (`studies/tuning.toml`). On the way it plays
greedy episodes and looks at the choices of each that fails: a policy that comes back to a state goes round
for ever, as policy and room are deterministic. It is compared with the training episodes since the last look, whose
exploration leads out of any cycle.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.agents.training.train import train
from hrl_escape.options.options_env import make_options_env

SETTINGS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "before": {"n_step": 1, "target_rate": 0.01, "target_every": 1, "average_rate": 0.0},
}
LONGEST_CYCLE, TURNS = 12, 4


def find_cycle(choices: Sequence[int]) -> int:
    """Length of the cycle, up to `LONGEST_CYCLE`, that a sequence ends with, `TURNS` times or more; 0 for none."""
    for length in range(1, LONGEST_CYCLE + 1):
        end = list(choices[-TURNS * length:])
        if len(end) == TURNS * length and end == end[-length:] * TURNS:
            return length
    return 0


@dataclass(frozen=True)
class Look:
    """A greedy episode, and the training episodes since the look before.

    Attributes:
        primitives: trained for.
        escaped: the greedy episode.
        cycle: at its end, in choices; 0 for none.
        trained: training episodes.
        escapes: training episodes that escaped.
    """

    primitives: int
    escaped: bool
    cycle: int
    trained: int
    escapes: int


@dataclass
class FrozenProbe:
    """Evaluates the frozen policy at fixed intervals of primitives."""

    env: gymnasium.Env
    every: int
    looks: list[Look] = field(default_factory=list)
    trained: int = 0
    escapes: int = 0
    identity: dict[str, Any] = field(default_factory=dict)
    is_done: bool = False

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Look at nothing."""

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Play a greedy episode, if it is due."""
        self.trained, self.escapes = self.trained + 1, self.escapes + bool(episode.success)
        if episode.primitives < self.every * (len(self.looks) + 1):
            return
        steps = [transition for transition, _ in play_episode(agent, self.env, seed=1)]
        cycle = find_cycle([int(step.action) for step in steps])
        self.looks.append(Look(episode.primitives, steps[-1].terminated, cycle, self.trained, self.escapes))
        self.trained = self.escapes = 0

    def state_dict(self) -> StateTree:
        """Nothing: these runs leave no checkpoints."""
        return {}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on from nothing."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each setting and seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", default="clutter")
    parser.add_argument("--primitives", type=int, default=50_000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--looks", type=int, default=20)
    chosen = parser.parse_args(arguments)
    print("| settings | seed | greedy episodes that fail | after one that escaped | in a cycle of one choice | of more "
          "| training episodes around these that escape |\n|---|---|---|---|---|---|---|")
    for name, settings in SETTINGS.items():
        for seed in range(chosen.seeds):
            looks = look(chosen.room, settings, seed, chosen.primitives, chosen.looks)
            failed = [each for each in looks if not each.escaped]
            first = next((each.primitives for each in looks if each.escaped), chosen.primitives)
            print(f"| {name} | {seed} | {len(failed)} of {len(looks)} | {sum(x.primitives > first for x in failed)} "
                  f"| {sum(x.cycle == 1 for x in failed)} | {sum(x.cycle > 1 for x in failed)} "
                  f"| {sum(x.escapes for x in failed)} of {sum(x.trained for x in failed)} |", flush=True)


def look(room: str, settings: dict[str, Any], seed: int, primitives: int, looks: int) -> list[Look]:
    """Train an agent and look at it on the way."""
    env, frozen = (make_options_env(room, observation="features") for _ in range(2))
    probe = FrozenProbe(frozen, primitives // looks)
    train("smdp-dqn+primitives", env, primitives=primitives, seed=seed, settings=settings, eval_episodes=0, probe=probe)
    return probe.looks


if __name__ == "__main__":
    main()
