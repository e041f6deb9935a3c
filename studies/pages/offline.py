"""Rules of the page on offline data."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("offline",)
CUT = ("smdp-behaviour-cloning best=0.1", "smdp-decision-transformer values=network passes=200")
"""Learners that imitate whole trajectories."""
BACKUP = ("smdp-fitted-q", "smdp-iql", "smdp-cql", "smdp-sharsa")
"""Learners of values over options."""


def do_options_help(numbers: Any) -> bool:
    """Both value-based learners do better over options than over primitives, and Q-iteration gains most."""
    gains = numbers.offline.horizon
    return all(gain.sign > 0 for gain in gains.values()) and gains["smdp-fitted-q"].mean == max(
        gain.mean for gain in gains.values())


def do_values_stitch(numbers: Any) -> bool:
    """Cut trajectories cost imitation learners, and no value-based learner loses significantly."""
    gains = numbers.offline.stitching
    return all(gains[agent].sign > 0 for agent in CUT) and all(
        gains[agent].sign == 0 and gains[agent].high < 0.1 for agent in BACKUP)


def does_search_win_outside(numbers: Any) -> bool:
    """In unseen rooms no network of any data reaches the search baseline."""
    return all(cell.high < numbers.offline.unseen_search for cell in numbers.offline.unseen.values())


def does_the_transformer_lead(numbers: Any) -> bool:
    """The decision transformer is the best network of every kind of data."""
    unseen = numbers.offline.unseen
    return all("decision-transformer" in max((agent for agent, other in unseen if other == kind),
                                             key=lambda agent: unseen[agent, kind].mean)
               for kind in {kind for _, kind in unseen})


RULES: Rules = {
    "options-help": do_options_help,
    "takeaway": do_options_help,
    "values-stitch": do_values_stitch,
    "search-wins-outside": does_search_win_outside,
    "the-transformer-leads": does_the_transformer_lead,
}
