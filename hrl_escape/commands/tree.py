"""Commands and groups of commands by the files that they are in. Not a command."""

from __future__ import annotations

import ast
from pathlib import Path


def find_commands(folder: Path) -> dict[str, Path]:
    """Names of the commands and groups in a folder, and where they are."""
    found = {}
    for path in sorted(folder.iterdir()):
        is_group = (path / "__init__.py").is_file()
        if is_group or (path.suffix == ".py" and _has_run(path)):
            found[path.stem.replace("_", "-")] = path
    return found


def _has_run(path: Path) -> bool:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(part, ast.FunctionDef) and part.name == "run" for part in body)
