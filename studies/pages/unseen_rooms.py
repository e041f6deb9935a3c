"""Rules of the page on unseen rooms."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("across", "marks", "storeys")
CONTROL, PRESS_MODEL = "cues-1/symbols-control", "smdp-press-model+objects"
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


def _get_learners(numbers: Any) -> dict[str, Any]:
    """The press model after 64 training rooms by rung, each over ten seasons or more."""
    found = {name: rung.learners[PRESS_MODEL, 64] for name, rung in numbers.across.rungs.items()}
    assert all(own.seasons >= 10 for own in found.values())
    return found


def does_the_press_model_gain_half(numbers: Any) -> bool:
    """Its normalised score is above one half with each of seven kinds of cues."""
    learners = _get_learners(numbers)
    return all((learners[name].share or 0) > 0.5 for name in _list_cues(numbers))


def does_it_infer_graphs(numbers: Any) -> bool:
    """In all families but `reset-6` it is significantly above counting, by 0.13 or more."""
    gains = {name: own.minus_counting for name, own in _get_learners(numbers).items() if name.startswith("families-1/")}
    return len(gains) == 5 and all((gain.low > 0 and round(gain.value, 2) >= 0.13) != (name == "families-1/reset-6")
                                   for name, gain in gains.items())


def does_it_infer_codes(numbers: Any) -> bool:
    """With latent codes it is significantly above counting, and elsewhere the difference is 0.04 at most."""
    learners = _get_learners(numbers)
    gains = {name: learners[name].minus_counting for name in _list_cues(numbers)}
    return gains.pop("cues-1/latent-codes").low > 0 and all(abs(gain.value) <= 0.04 for gain in gains.values())


def does_it_fall_short(numbers: Any) -> bool:
    """It is significantly below counting with dependencies and in the control, and with no other cue."""
    below = {name for name, own in _get_learners(numbers).items() if own.minus_counting.high < 0}
    return below == {"cues-1/dependencies", CONTROL}


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
    "press-model-gains-half": does_the_press_model_gain_half,
    "press-model-infers-graphs": does_it_infer_graphs,
    "press-model-infers-codes": does_it_infer_codes,
    "press-model-falls-short": does_it_fall_short,
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
