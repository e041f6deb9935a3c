"""The machine that a benchmark ran on, and the versions of the packages measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from typing import Any

__all__ = ["describe_machine"]


def describe_machine(*packages: str) -> dict[str, Any]:
    """Python, processor and versions, for a benchmark's JSON."""
    return {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count(),
            **{name: version(name) for name in ("hrl-escape", "gymnasium", "numpy", *packages)}}
