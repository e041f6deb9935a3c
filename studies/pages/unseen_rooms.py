"""Rules of the page on unseen rooms."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("across", "marks", "storeys")
CONTROL = "cues-1/symbols-control"
HARDLY = 0.01
"""Largest difference of efficiencies that are called equal."""


def _list_cues(numbers: Any) -> dict[str, Any]:
    found = {name: rung for name, rung in numbers.across.rungs.items()
             if name.startswith("cues-1/") and name != CONTROL}
    assert len(found) == 7 and all(rung.seasons >= 10 for rung in found.values())
    return found


def does_counting_gain_half(numbers: Any) -> bool:
    """After 64 training rooms the normalised score of counting is above one half with each of seven kinds of cues."""
    return all((rung.normalised[64] or 0) > 0.5 for rung in _list_cues(numbers).values())


def does_counting_beat_search(numbers: Any) -> bool:
    """After 64 training rooms counting is significantly above the best search baseline with each kind of cue."""
    return all(rung.gains[64].low > 0 for rung in _list_cues(numbers).values())


def is_there_headroom(numbers: Any) -> bool:
    """The lower bound of the headroom is above 0.1 on every rung but the control, in both benchmarks."""
    return all(rung.headroom.low > 0.1 for name, rung in numbers.across.rungs.items() if name != CONTROL)


def do_controls_teach_nothing(numbers: Any) -> bool:
    """In the control, intervals of the gain of counting and of the headroom contain 0."""
    control = numbers.across.rungs[CONTROL]
    return control.gains[64].low <= 0 <= control.gains[64].high and control.headroom.low <= 0 <= control.headroom.high


def is_counting_exact(numbers: Any) -> bool:
    """With colours and symbols, counting in 64 rooms has the efficiency of the Bayes planner."""
    return all(abs(rung.means["bayes", 0].value - rung.means["count-cues", 64].value) < HARDLY
               for rung in (numbers.across.rungs[f"cues-1/{kind}"] for kind in ("colours", "symbols")))


def are_families_hard(numbers: Any) -> bool:
    """In families under `ignore` counting is not significantly above search."""
    found = [rung for name, rung in numbers.across.rungs.items() if name.startswith("families-1/ignore")]
    return len(found) > 1 and all(rung.gains[64].low <= 0 <= rung.gains[64].high for rung in found)


def do_all_beat_search(numbers: Any) -> bool:
    """After 1,000 training rooms PPO is above the search baseline with every kind of cue."""
    return len(numbers.marks.kinds) == 7 and all(kind.most.low > kind.searcher for kind in numbers.marks.kinds.values())


def are_few_rooms_too_few(numbers: Any) -> bool:
    """With 16 training rooms PPO is below the search baseline with six kinds of seven."""
    return [rung for rung, kind in numbers.marks.kinds.items()
            if kind.told[16].high > kind.searcher] == ["marks-1/told"]


def does_ppo_gain_nothing_in_controls(numbers: Any) -> bool:
    """Without information in the cues PPO is not above the search baseline, and true cues are worth more."""
    return all(kind.control.high <= kind.control_searcher + 0.01 and kind.worth.low > 0
               for kind in numbers.marks.kinds.values())


def does_memory_pay(numbers: Any) -> bool:
    """Efficiency rises for the planner that remembers, and for neither reference that forgets."""
    found = numbers.storeys
    return found.remembering.low > 0 and all(own.low <= 0 <= own.high for own in (found.forgetting, found.searching))


RULES: Rules = {
    "counting-gains-half": does_counting_gain_half,
    "compare-with-counting": does_counting_beat_search,
    "headroom-everywhere": is_there_headroom,
    "controls-teach-nothing": do_controls_teach_nothing,
    "counting-is-exact": is_counting_exact,
    "families-are-hard": are_families_hard,
    "all-beat-search": do_all_beat_search,
    "few-rooms-are-too-few": are_few_rooms_too_few,
    "ppo-gains-nothing-in-controls": does_ppo_gain_nothing_in_controls,
    "memory-pays": does_memory_pay,
}
