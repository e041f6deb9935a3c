"""Rules of the page on options that are learned from moves."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("learned-options",)


FIRST_SIZE = 2
"""Buttons of the rooms whose comparisons are complete in the first stage."""


def do_options_not_pay(numbers: Any) -> bool:
    """In the first stage two buttons alone are compared, with DQN with novelty: PPOC and A2OC cost, DAC is open."""
    answers = {key: (gain.flat, gain.verdict) for key, gain in numbers.learned_options.first.gains.items()}
    return answers == {(FIRST_SIZE, label): ("dqn, novelty", verdict)
                       for label, verdict in (("dac", "open"), ("ppoc", "costs"), ("a2oc", "costs"))}


def is_rest_open(numbers: Any) -> bool:
    """No comparison in fresh rooms or in the second stage has all of its rooms."""
    study = numbers.learned_options
    return not any((study.first.fresh_gains, study.second.gains, study.second.fresh_gains))


def is_credit_slower(numbers: Any) -> bool:
    """PPOC and A2OC take longer from the first escape to the learned room than the best flat agent."""
    gains = numbers.learned_options.first.gains
    return all(gains[FIRST_SIZE, label].credit.low > 1.0 for label in ("ppoc", "a2oc"))


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
    "no-gain": do_options_not_pay,
    "wait": lambda numbers: do_options_not_pay(numbers) and is_rest_open(numbers),
    "credit": is_credit_slower,
    "no-second-stage": is_second_missing,
    "no-transfer": is_unseen_missing,
    "ppo-two-buttons": does_ppo_escape,
    "easy-trial": lambda numbers: numbers.learned_options.trial_fewest < numbers.learned_options.fewest,
}
