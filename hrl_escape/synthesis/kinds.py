"""Kinds of synthesised hierarchies and which agents act by them; a module of its own, so that names load no planner."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

from hrl_escape.agents.registry import SMDP_PREFIX, find_given_part, list_given_agents
from hrl_escape.errors import UnsupportedError

HierarchyKind: TypeAlias = Literal["maxq", "ham", "landmarks", "feudal"]
LeafKind: TypeAlias = Literal["planned", "learned"]
KINDS: tuple[HierarchyKind, ...] = ("maxq", "ham", "landmarks", "feudal")
LEAVES: tuple[LeafKind, ...] = ("planned", "learned")

PARTS: Mapping[HierarchyKind, str] = {"maxq": "hierarchy", "ham": "program", "landmarks": "goals", "feudal": "tree"}
"""Kind -> the argument by which agents take it."""


def find_kind(agent: str) -> HierarchyKind:
    """Kind of hierarchy that an agent acts by. Raises `UnknownNameError`, or `UnsupportedError` if there is none."""
    if agent.startswith(SMDP_PREFIX):
        raise UnsupportedError(f"{agent} chooses options, and a synthesised hierarchy calls primitives: take "
                               f"{agent.removeprefix(SMDP_PREFIX)}, or leave out `leaves`")
    part = find_given_part(agent)
    for kind, name in PARTS.items():
        if name == part:
            return kind
    others = [name for name in list_given_agents() if find_given_part(name) in PARTS.values()]
    raise UnsupportedError(f"no hierarchy is synthesised for {agent}, but for {', '.join(others)}: leave out `leaves`")


def list_privileges(agent: str, leaves: str) -> tuple[str, ...]:
    """Information that an agent with a synthesised hierarchy is given and a flat one is not."""
    structure = {"maxq": "task graph", "ham": "program", "landmarks": "landmarks", "feudal": "cells"}[find_kind(agent)]
    return (structure, "state", "planner") if leaves == "planned" else (structure, "state")
