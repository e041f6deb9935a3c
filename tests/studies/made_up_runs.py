"""Runs of a study written down by hand, so that what is measured in them is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from studies.raw import BINS, RawRun


def make_run(agent: str, scores: Sequence[float], *, training: Sequence[float] | None = None, seed: int = 0,
             room: str = "room", **changes: Any) -> RawRun:
    """A run of 1,000 primitives, worst -1000 and best 0, so that a score s is a return of 1000 (s - 1).

    Efficiencies are the scores.

    Args:
        agent: label.
        scores: of evaluations at equal distances from 0 to the end.
        training: scores of training episodes, one a twentieth; an episode above 0 escaped. As the last of `scores`.
        seed: of training.
        room: name.
        changes: other fields.
    """
    training = list(training if training is not None else [scores[-1]] * BINS)
    places = [round(1000 * n / max(len(scores) - 1, 1)) for n in range(len(scores))]
    escaped = [score > 0 for score in training]
    first = 50 * (escaped.index(True) + 1) if any(escaped) else None
    run = RawRun(
        agent=agent, room=room, seed=seed, worst=-1000.0, best=0.0, axis="primitives", budget=1000,
        primitives=tuple(places), decisions=tuple(place // 10 for place in places),
        returns=tuple(1000 * (score - 1) for score in scores), successes=tuple(float(score > 0) for score in scores),
        episodes=(1,) * BINS, training_returns=tuple(1000 * (score - 1) for score in training),
        training_successes=tuple(map(int, escaped)), training_optimal=tuple(int(score >= 0.99) for score in training),
        first_escape=first, efficiencies=tuple(map(float, scores)), training_efficiencies=tuple(map(float, training)),
        entropy=(1.0,) * BINS, greedy=(0.5,) * BINS, longest_repeat=(1.0,) * BINS,
    )
    return dataclasses.replace(run, **changes)
