"""Shared parts of the conformance benchmarks: their rooms, and a file of findings to continue from."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.files import read_json
from tests.env.rooms import all_configs

__all__ = ["list_batched_rooms", "load_findings"]


def list_batched_rooms(names: Collection[str] | None) -> Iterator[tuple[str, RoomConfig]]:
    """Presets and knob extremes that the batched engine knows, of these names; all of them where there are none."""
    for name, config in all_configs().items():
        if names and name not in names:
            continue
        if config.dynamics.kind == "kinematic":
            yield name, config
        else:
            print(f"{name:20} left out: the batched engine knows no physics")


def load_findings(path: str | None) -> dict[str, Any]:
    """Room -> settings and findings of earlier calls; empty without a file."""
    return read_json(path, "findings of a conformance check") if path and os.path.exists(path) else {}
