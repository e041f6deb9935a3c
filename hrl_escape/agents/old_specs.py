"""Agent labels of version 0.3: what they are called now.

`smdp-dqn` of 0.3 chose among options and primitives and is `smdp-dqn+primitives` now, so files that hold labels carry a
version. Where a label can only be of 0.3, it is refused with the new text.
"""

from __future__ import annotations

from hrl_escape.agents.keras_rl_2019.recipes import CHANGES
from hrl_escape.agents.registry import (
    DEFAULT_RECIPE,
    KERAS_RL,
    RANDOM_OPTIONS,
    SHARED_RECIPES,
    SMDP_PREFIX,
    join_name,
    list_offline_agents,
    split_name,
)
from hrl_escape.errors import AgentSettingsError, UnknownNameError

NEW_NAMES = {
    "smdp-random": RANDOM_OPTIONS,
    "smdp-untried-nearest": "search-nearest",
    "smdp-untried": "search-random",
    "smdp-retrace": "search-backtrack",
    "smdp-index-order": "sweep",
    "smdp-shuffled-round": "sweep-random",
    "smdp-bayes": "bayes",
    "planner": "oracle",
    "smdp-tools": "text-agent",
}
"""Names of agents of 0.3 that have changed."""
FINITE = {"hiro": "hiro-finite", "hrac": "hrac-finite", "hac": "hac-finite"}
"""Names of agents of 0.3 that mean another algorithm now: those chose among finitely many goals and actions."""
MANAGERS = {"uniform": "random", "untried": "search-random", "untried-nearest": "search-nearest", "planner": "oracle"}
"""Scripted callers of tools of 0.3."""
_PARTS = {"markov": "reactive"}
_OLD_PARTS = ("no-primitives", "markov", *SHARED_RECIPES)
_ORDER = ("objects", "memory", "gru", "reactive", "primitives", "planned", "learned")


def convert_label(label: str, chooses_primitives: bool | None = None) -> str:
    """The spec of an agent label of version 0.3.

    Args:
        label: such as `smdp-dqn+no-primitives`.
        chooses_primitives: whether an agent over options chose among primitives too; by default as the label says.

    Raises:
        UnknownNameError: it has a word that no label of 0.3 had.
        AgentSettingsError: it had two recipes in effect, which no spec has.
    """
    head, *words = label.split("+")
    name, _, recipe = head.partition("@")
    recipe, over_options = _convert_recipe(name, recipe), name.startswith(SMDP_PREFIX)
    if chooses_primitives is None:
        chooses_primitives = "no-primitives" not in words
    parts = []
    for word in words:
        if word in SHARED_RECIPES:
            if recipe != DEFAULT_RECIPE:
                raise AgentSettingsError("agent", label, f"a label with one of {recipe} and {word}")
            recipe = word
        elif word != "no-primitives":
            part = _PARTS.get(word, word)
            if part not in _ORDER:
                raise UnknownNameError("word of a label of version 0.3", word, (*_OLD_PARTS, *_ORDER))
            parts.append(part)
    base, is_over = split_name(name)
    new = NEW_NAMES.get(name, join_name(FINITE[base], is_over) if base in FINITE else name)
    is_fixed = new != RANDOM_OPTIONS and not new.startswith(SMDP_PREFIX)
    is_offline = split_name(name)[0] in list_offline_agents()  # these choose what their data set has
    if over_options and chooses_primitives and not is_fixed and not is_offline:
        parts.append("primitives")
    return (new + f"@{recipe}" * (recipe != DEFAULT_RECIPE)
            + "".join(f"+{part}" for part in sorted(set(parts), key=_ORDER.index)))


def _convert_recipe(name: str, recipe: str) -> str:
    """Named settings; an agent of a third party may have some that are called `paper`."""
    if recipe == "paper" and split_name(name)[0] in CHANGES:
        return KERAS_RL
    return DEFAULT_RECIPE if recipe == "corrected" else recipe or DEFAULT_RECIPE


def refuse_old(text: str) -> None:
    """Refuse what only a label of version 0.3 says.

    Raises:
        AgentSettingsError: the message gives the spec.
    """
    head, *words = text.split("+")
    name, _, recipe = head.partition("@")
    is_finite = split_name(name)[0] in FINITE and (name not in FINITE or bool(set(words) & {"planned", "learned"}))
    is_old = name in NEW_NAMES or is_finite or (recipe and _convert_recipe(name, recipe) != recipe)
    if not (is_old or set(words) & set(_OLD_PARTS)):
        return
    known = [word for word in words if word in (*_OLD_PARTS, *_ORDER)]
    spec = convert_label("+".join((head, *known)), False if is_finite else None)
    raise AgentSettingsError("agent", text, f"version 0.3 called this agent so; it is {spec} now")
