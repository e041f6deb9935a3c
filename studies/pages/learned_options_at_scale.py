"""Rules of the page on options that are learned from moves."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("learned-options",)


def is_open(numbers: Any) -> bool:
    """No registered comparison has all of its rooms, in any stage."""
    study = numbers.learned_options
    return not any(gains for stage in (study.first, study.second) for gains in (stage.gains, stage.fresh_gains))


def is_second_missing(numbers: Any) -> bool:
    """No run of the second stage was made."""
    return not any(runs for cells in numbers.learned_options.second.sizes.values() for label, runs in cells.items()
                   if label not in SHORT)


def is_unseen_missing(numbers: Any) -> bool:
    """No run with options from training rooms was made."""
    return not any(label in cells for stage in (numbers.learned_options.first, numbers.learned_options.second)
                   for cells in stage.unseen.values() for label in ("dac, egocentric", "ppo, reused options"))


def does_ppo_escape(numbers: Any) -> bool:
    """In the first stage with two buttons, all runs of PPO escape, and none is half as efficient as the best known."""
    study = numbers.learned_options
    runs = study.first.sizes[2].get("ppo", {}).values()
    return len(runs) >= study.data["rooms"] and all(run.first_escape is not None and run.late < 0.5 for run in runs)


SHORT = ("ppo, planned options",)
"""Learners whose runs are the same in both stages."""

RULES: Rules = {
    "no-verdict": is_open,
    "wait": is_open,
    "no-second-stage": is_second_missing,
    "no-transfer": is_unseen_missing,
    "ppo-two-buttons": does_ppo_escape,
    "easy-trial": lambda numbers: numbers.learned_options.trial_fewest < numbers.learned_options.fewest,
}
