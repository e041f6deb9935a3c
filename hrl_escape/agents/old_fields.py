"""New names of the fields, classes and option sets in files of version 0.3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MOVED = {"hrl_escape.agents.algorithms.given.": "hrl_escape.agents.algorithms.task_hierarchies.",
         "hrl_escape.agents.larg2019.": "hrl_escape.agents.keras_rl_2019.",
         "hrl_escape.agents.label": "hrl_escape.agents.spec",
         "hrl_escape.comparison.places:RoomSchedule": "hrl_escape.sets.room_schedule:RoomSchedule",
         **{f"hrl_escape.ladder.{name}:": f"hrl_escape.sets.{name}:"
            for name in ("common_spaces", "goals", "instance_set", "sequence")},
         "hrl_escape.synthesis.": "hrl_escape.hierarchies.",
         "hrl_escape.text.told_env:ToldEnv": "hrl_escape.text.text_env:TextEnv"}
"""Modules of version 0.3 that have moved."""
RENAMED = {"hrl_escape.hierarchies.hierarchy_env:HierarchyEnv": {"leaves": "low_level"},
           "hrl_escape.sets.goals:GoalsEnv": {"escapes": "exits"},
           "hrl_escape.text.text_env:TextEnv": {"told": "reveal"}}
"""New names of arguments of environments and wrappers, by class."""
NEW_FIELDS = {"flavour": "option_set", "stream_updates": "max_updates", "stream_replay": "replay_per_env",
              "stream_rollout": "rollout_per_env"}
"""New names of fields of any table."""
VALUES = {"press-markov": "press-reactive"}
"""New names of option sets."""


def rename_fields(value: Any) -> Any:
    """Return a JSON value with the new names of classes, fields, arguments and option sets."""
    if isinstance(value, list):
        return [rename_fields(each) for each in value]
    if isinstance(value, str):
        for old, new in MOVED.items():
            if value.startswith(old):
                return new + value.removeprefix(old)
        return VALUES.get(value, value)
    if not isinstance(value, Mapping):
        return value
    made = {NEW_FIELDS.get(name, name): rename_fields(each) for name, each in value.items()}
    names = RENAMED.get(made.get("class", ""), {}) if isinstance(made.get("class", ""), str) else {}
    if names and isinstance(made.get("arguments"), dict):
        made["arguments"] = {names.get(name, name): each for name, each in made["arguments"].items()}
    return made
