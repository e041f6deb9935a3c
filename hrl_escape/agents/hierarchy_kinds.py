"""Kinds of synthesised hierarchies and which agents act by them; a module of its own, so that names load no planner."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

from hrl_escape.agents.registry import SMDP_PREFIX, find_hierarchy_part, get_agent_class, list_hierarchy_agents
from hrl_escape.errors import UnsupportedError

HierarchyKind: TypeAlias = Literal["maxq", "ham", "landmarks", "feudal", "events", "displacements"]
LowLevel: TypeAlias = Literal["planned", "learned"]
KINDS: tuple[HierarchyKind, ...] = ("maxq", "ham", "landmarks", "feudal", "events", "displacements")
WITHOUT_PLANS: tuple[HierarchyKind, ...] = ("events", "displacements")
"""Kinds whose low level is always learned."""
LOW_LEVELS: tuple[LowLevel, ...] = ("planned", "learned")

STRUCTURES: Mapping[HierarchyKind, str] = {
    "maxq": "hierarchy", "ham": "program", "landmarks": "goals", "feudal": "tree", "events": "goal_space",
    "displacements": "goal_space"}
"""Kind -> the argument of agents that receives it."""


def find_kind(agent: str, low_level: str = "learned") -> HierarchyKind:
    """Kind of hierarchy that an agent acts by.

    Raises:
        UnknownNameError: no such agent.
        UnsupportedError: it acts by none, or its low level cannot be planned.
    """
    if agent.startswith(SMDP_PREFIX):
        raise UnsupportedError(f"{agent} chooses options, and a synthesised hierarchy calls primitives: take "
                               f"{agent.removeprefix(SMDP_PREFIX)}, or leave out `low_level`")
    part = find_hierarchy_part(agent)
    kinds: list[HierarchyKind] = [kind for kind in KINDS if STRUCTURES[kind] == part]
    if not kinds:
        others = [name for name in list_hierarchy_agents() if find_hierarchy_part(name) in STRUCTURES.values()]
        raise UnsupportedError(f"no hierarchy is synthesised for {agent}, but for {', '.join(others)}: leave out "
                               "`low_level`")
    kind = "displacements" if getattr(get_agent_class(agent), "names_displacements", False) else kinds[0]
    check_low_level(kind, low_level)
    return kind


def check_low_level(kind: HierarchyKind, low_level: str) -> None:
    """Raise `UnsupportedError` where a kind has no planned low level."""
    if low_level == "planned" and kind in WITHOUT_PLANS:
        raise UnsupportedError(f"a hierarchy over {kind} learns its low level: take low_level='learned'")


def list_privileges(agent: str, low_level: str) -> tuple[str, ...]:
    """Information that an agent with a synthesised hierarchy is given and a flat one is not."""
    kind = find_kind(agent, low_level)
    structure = {"maxq": "task graph", "ham": "program", "feudal": "cells", "displacements": ""}.get(kind, "landmarks")
    return tuple(filter(None, (structure, "state", "planner" if low_level == "planned" else "")))
