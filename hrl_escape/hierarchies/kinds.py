"""Kinds of synthesised hierarchies and which agents act by them; a module of its own, so that names load no planner."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

from hrl_escape.agents.registry import SMDP_PREFIX, find_given_part, get_agent_class, list_given_agents
from hrl_escape.errors import UnsupportedError

HierarchyKind: TypeAlias = Literal["maxq", "ham", "landmarks", "feudal", "events", "displacements"]
LeafKind: TypeAlias = Literal["planned", "learned"]
KINDS: tuple[HierarchyKind, ...] = ("maxq", "ham", "landmarks", "feudal", "events", "displacements")
WITHOUT_PLANS: tuple[HierarchyKind, ...] = ("events", "displacements")
"""Kinds whose leaves are always learned."""
LEAVES: tuple[LeafKind, ...] = ("planned", "learned")

PARTS: Mapping[HierarchyKind, str] = {"maxq": "hierarchy", "ham": "program", "landmarks": "goals", "feudal": "tree",
                                      "events": "goal_space", "displacements": "goal_space"}
"""Kind -> the argument by which agents take it."""


def find_kind(agent: str, leaves: str = "learned") -> HierarchyKind:
    """Kind of hierarchy that an agent acts by.

    Raises:
        UnknownNameError: no such agent.
        UnsupportedError: it acts by none, or learns leaves that are to be planned.
    """
    if agent.startswith(SMDP_PREFIX):
        raise UnsupportedError(f"{agent} chooses options, and a synthesised hierarchy calls primitives: take "
                               f"{agent.removeprefix(SMDP_PREFIX)}, or leave out `leaves`")
    part = find_given_part(agent)
    kinds: list[HierarchyKind] = [kind for kind in KINDS if PARTS[kind] == part]
    if not kinds:
        others = [name for name in list_given_agents() if find_given_part(name) in PARTS.values()]
        raise UnsupportedError(f"no hierarchy is synthesised for {agent}, but for {', '.join(others)}: leave out "
                               "`leaves`")
    kind = "displacements" if getattr(get_agent_class(agent), "names_displacements", False) else kinds[0]
    check_leaves(kind, leaves)
    return kind


def check_leaves(kind: HierarchyKind, leaves: str) -> None:
    """Raise `UnsupportedError` for planned leaves of a kind that has none."""
    if leaves == "planned" and kind in WITHOUT_PLANS:
        raise UnsupportedError(f"a hierarchy over {kind} learns its leaves: take leaves='learned'")


def list_privileges(agent: str, leaves: str) -> tuple[str, ...]:
    """Information that an agent with a synthesised hierarchy is given and a flat one is not."""
    kind = find_kind(agent, leaves)
    structure = {"maxq": "task graph", "ham": "program", "feudal": "cells", "displacements": ""}.get(kind, "landmarks")
    return tuple(filter(None, (structure, "state", "planner" if leaves == "planned" else "")))
