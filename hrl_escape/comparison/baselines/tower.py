"""Section of the baselines' page on the tower, from its lines alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hrl_escape.comparison.baselines.lines import LEAST_RUNS, BaselineRun, compute_run_efficiency
from hrl_escape.comparison.protocols import TOWER
from hrl_escape.ladder.tower import TOWER_HORIZON
from hrl_escape.names import count_nouns

__all__ = ["describe_tower"]


def describe_tower(lines: Sequence[BaselineRun], command: str, budget: int) -> list[str]:
    """Lines of the section; none without a run.

    Args:
        lines: runs in the tower.
        command: beginning of the command line that makes them.
        budget: primitives that the protocol itself trains for.
    """
    if not lines:
        return []
    floors = max(line.rooms.partition(" > ")[2] for line in lines)
    episodes = max(line.episodes for line in lines)
    text = [f"## {TOWER}", "", f"Floor above floor in one episode of {TOWER_HORIZON:,} primitives: {floors}. "
            "Efficiency is the mean over floors, of which one that is not climbed counts 0; "
            f"{count_nouns(episodes, 'episode')} an evaluation.{_describe_limits(lines, budget)}", "",
            "| agent | runs | trained for | efficiency | floors climbed |", "|---|---|---|---|---|"]
    agents = list(dict.fromkeys(line.agent for line in sorted(lines, key=lambda line: -line.efficiency)))
    for agent in agents:
        runs = [line for line in lines if line.agent == agent]
        most = max(run.primitives for run in runs)
        runs = [run for run in runs if run.primitives == most]
        text.append(f"| `{agent}` | {len(runs)} | {most:,} | {compute_run_efficiency(runs):.2f} | "
                    f"{float(np.mean([run.escapes for run in runs])):.0%} |")
    words = [command, "--protocol", TOWER, "--agents", *agents, "--runs", str(1 + max(line.seed for line in lines)),
             "--rooms", str(episodes)]
    if trained := max(line.primitives for line in lines):
        words += ["--primitives", str(trained)]
    return [*text, "", "```console", " ".join(words), "```", ""]


def _describe_limits(lines: Sequence[BaselineRun], budget: int) -> str:
    """Sentences on too small a budget and too few runs; empty where both are enough."""
    trained = max(line.primitives for line in lines)
    fewest = min(Counter((line.agent, line.primitives) for line in lines).values())
    short = f" Learners train for {trained:,} primitives, less than the tower's own {budget:,}."
    few = f" Nothing is concluded from fewer than {LEAST_RUNS} runs."
    return (short if 0 < trained < budget else "") + (few if fewest < LEAST_RUNS else "")
