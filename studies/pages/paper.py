"""Rules of the page on the 2019 paper."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("paper", "factorial")
HELPS, BEATS_CHANCE, WORSENS = 7, 8, 10
"""Numbers of claims: options help, beyond random choices, and SARSA and DDPG get worse."""
CAUSES = ("buffer", "choices", "scaling")


def get_verdicts(numbers: Any, claim: int) -> dict[str, bool | None]:
    """Verdicts on a claim by algorithm: True, False, or None where it stays open."""
    return numbers.paper.claims[claim - 1].verdicts


def count_kinds(numbers: Any) -> dict[str, int]:
    """Claims that hold for all algorithms, for none, for some, and those that stay open."""
    kinds = [claim.kind for claim in numbers.paper.claims]
    return {kind: kinds.count(kind) for kind in ("yes", "no", "some", "none", "open")}


def do_options_help(numbers: Any) -> bool:
    """Options help DQN and SARSA, no algorithm beats random choices among them."""
    helps = get_verdicts(numbers, HELPS)
    return bool(helps["dqn"] and helps["sarsa"]) and set(get_verdicts(numbers, BEATS_CHANCE).values()) == {False}


def do_defaults_help(numbers: Any) -> bool:
    """The default settings raise the training score of all three algorithms."""
    return all(gain.sign > 0 for gain in numbers.paper.settings.values())


def do_verdicts_stand(numbers: Any) -> bool:
    """Three claims hold, one fails, four stay open, and algorithms differ in the others."""
    return count_kinds(numbers) == {"yes": 3, "no": 1, "some": 5, "none": 1, "open": 4}


def does_chance_settle(numbers: Any) -> bool:
    """Random choices pass the tests of claims 1, 2 and 9, and fail the test of claim 6."""
    settled = {number: claim.by_chance for number, claim in enumerate(numbers.paper.claims, 1)
               if claim.by_chance is not None}
    return settled == {1: True, 2: True, 6: False, 9: True}


def does_sarsa_worsen(numbers: Any) -> bool:
    """SARSA gets worse with options, as published; for DDPG it stays open."""
    return get_verdicts(numbers, WORSENS) == {"sarsa": True, "ddpg": None}


def are_causes_found(numbers: Any) -> bool:
    """Three factors raise the slope of SARSA, no other factor changes it, and all three do so in fresh rooms."""
    effects, again = numbers.factorial.slopes["sarsa"], numbers.factorial.again["sarsa"]
    return {name for name, effect in effects.items() if effect.is_shown} == set(CAUSES) == {
        name for name, effect in again.items() if effect.is_shown} and all(
        own[name].test.difference > 0 for own in (effects, again) for name in CAUSES)


def is_ddpg_open(numbers: Any) -> bool:
    """No factor changes the slope of DDPG significantly."""
    return not any(effect.is_shown for effect in numbers.factorial.slopes["ddpg"].values())


def does_the_policy_repeat(numbers: Any) -> bool:
    """With the settings of 2019 efficiency falls while one action is repeated for ever longer."""
    efficiency = numbers.factorial.course["efficiency", "2019"]
    repeats = numbers.factorial.course["longest repeat, decisions", "2019"]
    return efficiency[-1] < 0.2 * efficiency[0] and repeats[-1] > 20 * repeats[0]


def is_one_rerun_apart(numbers: Any) -> bool:
    """All experiments but one are within 0.25 of the published program."""
    return [own.rerun.words for own in numbers.paper.reruns if abs(own.gap) > 0.25] == ["sarsa, one button at 10 m"]


RULES: Rules = {
    "options-help": do_options_help,
    "defaults-help": do_defaults_help,
    "verdicts": do_verdicts_stand,
    "chance-settles": does_chance_settle,
    "sarsa-worsens": does_sarsa_worsen,
    "causes": are_causes_found,
    "ddpg-is-open": is_ddpg_open,
    "the-policy-repeats": does_the_policy_repeat,
    "one-rerun-apart": is_one_rerun_apart,
}
