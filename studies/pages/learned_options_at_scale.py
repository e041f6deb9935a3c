"""Rules of the page on options that are learned from moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.publishing import Rules

STUDIES = ("learned-options",)


OWN = ("dac", "ppoc", "a2oc")
"""Agents that learn their own options."""
SIZES = (1, 2, 3)
"""Buttons of the rooms whose comparisons are complete in the first stage."""
NOVEL = "dqn, novelty"


def do_options_not_pay(numbers: Any) -> bool:
    """In the first stage, with one to three buttons, no agent that learns options pays, and DAC is open."""
    gains = numbers.learned_options.first.gains
    return (set(gains) == {(buttons, label) for buttons in SIZES for label in OWN}
            and all(gain.verdict == "open" or (gain.verdict == "costs" and label != "dac")
                    for (_, label), gain in gains.items()))


def is_novelty_first(numbers: Any) -> bool:
    """DQN with novelty is the best flat agent with one and two buttons; beyond, no mean over moves reaches 0.2."""
    study = numbers.learned_options
    known = {"ppo, planned options", "archive"}
    late = [float(np.mean([run.late for run in runs.values()])) for buttons in (3, 4)
            for label, runs in study.first.sizes[buttons].items() if label not in known]
    return (all(study.first.gains[buttons, label].flat == NOVEL for buttons in (1, 2) for label in OWN)
            and len(late) >= 15 and max(late) < 0.2)


def do_fresh_rooms_agree(numbers: Any) -> bool:
    """In fresh rooms with two and three buttons, DAC is open, and PPOC and A2OC do worse than DQN with novelty."""
    found = {key: (gain.flat, gain.verdict) for key, gain in numbers.learned_options.first.fresh_gains.items()}
    return found == {(buttons, label): (NOVEL, "open" if label == "dac" else "costs")
                     for buttons in (2, 3) for label in OWN}


def are_answers_confirmed(numbers: Any) -> bool:
    """Of the comparisons in fresh rooms, DAC's and A2OC's with two buttons have the answers of the first rooms."""
    first = numbers.learned_options.first
    same = {key for key, gain in first.fresh_gains.items() if gain.verdict == first.gains[key].verdict}
    return same == {(2, "dac"), (3, "dac"), (2, "a2oc")}


def is_credit_slower(numbers: Any) -> bool:
    """With one and two buttons, PPOC and A2OC take longer from the first escape to the learned room than DQN."""
    gains = numbers.learned_options.first.gains
    return all(gains[buttons, label].flat == NOVEL and gains[buttons, label].times.credit.low > 1.0
               for buttons in (1, 2) for label in ("ppoc", "a2oc"))


def is_first_escape_no_earlier(numbers: Any) -> bool:
    """No interval of the ratio of first escapes lies below 1."""
    return all(gain.times.first.high >= 1.0 for gain in numbers.learned_options.first.gains.values())


def does_untrained_escape_first(numbers: Any) -> bool:
    """The untrained policy with repeats has an earlier median first escape than agents that learn options."""
    sizes = numbers.learned_options.first.sizes
    return all(find_median(sizes[buttons]["untrained, repeats"]) < find_median(sizes[buttons][label])
               for buttons in SIZES for label in OWN)


def do_planned_options_escape_first(numbers: Any) -> bool:
    """With one to four buttons, planned options have less than a twentieth of every other median first escape."""
    sizes = numbers.learned_options.first.sizes
    return all(20 * find_median(sizes[buttons]["ppo, planned options"]) < find_median(runs)
               for buttons in (*SIZES, 4) for label, runs in sizes[buttons].items() if label not in SHORT)


def find_median(runs: Mapping[int, Any]) -> float:
    """Median primitives to the first escape of the runs of a cell."""
    return float(np.median([run.first_escape or np.inf for run in runs.values()]))


def is_second_missing(numbers: Any) -> bool:
    """No run of the second stage was made."""
    return not any(runs for cells in numbers.learned_options.second.sizes.values() for label, runs in cells.items()
                   if label not in SHORT)


def is_reset_alike(numbers: Any) -> bool:
    """With three buttons no mean late efficiency over moves moves by more than 0.05 if wrong presses reset."""
    stage = numbers.learned_options.first
    gaps = [np.mean([run.late for run in runs.values()]) - np.mean([run.late for run in stage.sizes[3][label].values()])
            for label, runs in stage.reset[3].items() if label not in SHORT]
    return len(gaps) == 5 and max(map(abs, gaps)) <= 0.05


def is_reuse_slower(numbers: Any) -> bool:
    """With two buttons reused options delay learning and fewer runs escape."""
    stage = numbers.learned_options.first
    times = stage.reuse[2]
    return times.credit.low > 1.0 and times.first.search < times.first.learner


def does_ppo_escape(numbers: Any) -> bool:
    """In the first stage with two buttons, all runs of PPO escape, and none is half as efficient as the best known."""
    study = numbers.learned_options
    runs = study.first.sizes[2].get("ppo", {}).values()
    return len(runs) >= study.data["rooms"] and all(run.first_escape is not None and run.late < 0.5 for run in runs)


SHORT = ("ppo, planned options",)
"""Learners whose runs are the same in both stages."""

RULES: Rules = {
    "no-gain": do_options_not_pay,
    "wait": is_novelty_first,
    "confirmation": do_fresh_rooms_agree,
    "confirmed": are_answers_confirmed,
    "credit": is_credit_slower,
    "no-crossover": lambda numbers: numbers.learned_options.first.crossover is None,
    "exploration": is_first_escape_no_earlier,
    "untrained": does_untrained_escape_first,
    "planned": do_planned_options_escape_first,
    "reset": is_reset_alike,
    "reuse": is_reuse_slower,
    "no-second-stage": is_second_missing,
    "ppo-two-buttons": does_ppo_escape,
    "easy-trial": lambda numbers: numbers.learned_options.trial_fewest < numbers.learned_options.fewest,
}
