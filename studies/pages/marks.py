"""Rules of the page on cues."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("marks",)
RISEN = ("marks-2/words", "marks-2/motifs", "marks-3/deceived", "marks-4/rules")
"""Sets with a significant rise of efficiency by 0.2 from 16 to 1,000 training rooms."""


def do_all_beat_search(numbers: Any) -> bool:
    """After 1,000 training rooms the learner is above the search baseline with every kind of cue."""
    return len(numbers.marks.kinds) == 7 and all(kind.most.low > kind.searcher for kind in numbers.marks.kinds.values())


def is_headroom_left(numbers: Any) -> bool:
    """The learner covers less than all of the way to the Bayes planner, and with some cues about a third."""
    shares = numbers.marks.shares
    return max(shares) < 0.95 and sum(share < 0.45 for share in shares) == 3


def are_few_rooms_too_few(numbers: Any) -> bool:
    """With 16 training rooms the learner is below the search baseline with six kinds of seven."""
    return [rung for rung, kind in numbers.marks.kinds.items()
            if kind.told[16].high > kind.searcher] == ["marks-1/told"]


def do_many_rooms_teach(numbers: Any) -> bool:
    """Efficiency rises by 0.2 in these sets, and not in the others."""
    return tuple(rung for rung, kind in numbers.marks.kinds.items() if kind.rise.low >= 0.2) == RISEN


def do_controls_teach_nothing(numbers: Any) -> bool:
    """Without information in the cues the learner is not above the search baseline, and true cues are worth more."""
    return all(kind.control.high <= kind.control_searcher + 0.01 and kind.worth.low > 0
               for kind in numbers.marks.kinds.values())


RULES: Rules = {
    "all-beat-search": do_all_beat_search,
    "compare-with-bayes": lambda n: do_all_beat_search(n) and is_headroom_left(n),
    "headroom-is-left": is_headroom_left,
    "few-rooms-are-too-few": are_few_rooms_too_few,
    "many-rooms-teach": do_many_rooms_teach,
    "controls-teach-nothing": do_controls_teach_nothing,
}
