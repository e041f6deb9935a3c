"""Result of a run as its end: efficiency, escapes, progress and the first escape, for studies that follow no curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.statistics import compute_iqm
from studies.store import Line

__all__ = ["BaselineRun", "collect_baselines", "compute_run_efficiency"]


@dataclass(frozen=True)
class BaselineRun(Line):
    """Result of one run of a rung.

    Attributes:
        protocol: such as `per-instance`.
        rung: name.
        rooms: room, or sets of rooms, in short text.
        agent: label.
        seed: of training.
        primitives: training budget; 0 for agents without training.
        efficiency: in the last fifth of training.
        seen: the same in rooms trained in, or None if test rooms are the training rooms.
        escapes: share of the evaluation episodes of the last fifth that escaped.
        episodes: in an evaluation.
        progress: mean share of the facts on the way to the goal that hold.
        first_escape: primitives to the first escape in training, or None without one.
        key: hash of everything that decides the run's numbers.
    """

    protocol: str
    rung: str
    rooms: str
    agent: str
    seed: int
    primitives: int
    efficiency: float
    seen: float | None
    escapes: float
    episodes: int
    progress: float
    first_escape: int | None
    key: str

    PLACE = ("protocol", "rung", "rooms", "agent", "seed", "primitives")


def collect_baselines(comparison: Comparison, protocol: str, rung: str) -> list[BaselineRun]:
    """Lines of the finished runs of a rung under a protocol."""
    return [BaselineRun(
        protocol=protocol, rung=rung, rooms=run.room, agent=run.agent.label, seed=run.seed,
        primitives=run.grid.primitives if run.agent.learns else 0,
        efficiency=round(result.get_final("efficiency"), 4),
        seen=None if result.seen_efficiency is None else round(result.seen_efficiency, 4),
        escapes=round(result.get_final("success_rate"), 4), episodes=run.grid.eval_episodes,
        progress=round(result.get_final("mean_progress"), 4),
        first_escape=result.first_escape if run.agent.learns else None, key=run.key,
    ) for run, result in comparison.runs]


def compute_run_efficiency(runs: Sequence[BaselineRun]) -> float:
    """Interquartile mean over runs; of fewer than four the mean."""
    return float(compute_iqm([np.array([run.efficiency for run in runs])]))
