"""A study: a folder with its grid as data, its analysis and the results of its runs.

| file | holds |
|---|---|
| `study.toml` | `about`, a line; `comparisons` by name or `[[grid]]` tables; other settings of the analysis |
| `analysis.py` | `analyse(study, lines)`, which returns `Findings`; other than default `Args`, `LINES`, `measure` |
| `raw.jsonl` | a line a run, see `Store` |

A study with `made_with` keeps the runs of that version, which is the last with the code that makes them. Without an
`analysis.py` it keeps data alone.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.presets import get_grid
from hrl_escape.errors import FileReadError, UnknownNameError
from hrl_escape.files import read_toml
from studies.figures import Drawing

__all__ = ["ROOT", "Findings", "Study", "find_study", "list_studies"]

ROOT = Path(__file__).parent
"""Folder of all studies."""
DEFINITION = "study.toml"


class Findings(NamedTuple):
    """Result of an analysis, for pages, tests and the command.

    Attributes:
        numbers: fields of pages, which their rules read too.
        tables: name -> Markdown; names are unique among the studies of a page.
        figures: name -> function that draws it for a theme.
    """

    numbers: SimpleNamespace
    tables: Mapping[str, str]
    figures: Mapping[str, Drawing] = {}


@dataclass(frozen=True)
class Study:
    """A folder of a study.

    Attributes:
        folder: where it is.
        data: its `study.toml`.
    """

    folder: Path
    data: Mapping[str, Any] = field(hash=False)

    @property
    def name(self) -> str:
        """The folder's with hyphens, as in the command."""
        return _name(self.folder)

    @property
    def command(self) -> str:
        """Beginning of every command line that runs it."""
        return f"python -m studies {self.name if self.folder.parent == ROOT else self.folder}"

    @property
    def holds_data_alone(self) -> bool:
        """True where its runs are kept without an analysis."""
        return "made_with" in self.data and not (self.folder / "analysis.py").is_file()

    @cached_property
    def grids(self) -> tuple[Grid, ...]:
        """Its grids: comparisons that come with the package, then its own."""
        return (*map(get_grid, self.data.get("comparisons", ())),
                *(Grid.from_dict(table) for table in self.data.get("grid", ())))

    @cached_property
    def analysis(self) -> ModuleType:
        """The module `analysis.py`, or another that `analysis` in `study.toml` names, which several studies share."""
        name = self.data.get("analysis", f"{ROOT.name}.{self.folder.name}.analysis")
        if self.holds_data_alone:
            raise FileReadError(f"{self.folder} holds data alone. The last version with the code of this study is "
                                f"{self.data['made_with']}")
        if "analysis" in self.data or self.folder.parent == ROOT:
            return importlib.import_module(name)
        spec = importlib.util.spec_from_file_location(name, self.folder / "analysis.py")
        assert spec is not None and spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
        try:
            spec.loader.exec_module(module)
        except FileNotFoundError:
            raise FileReadError(f"{self.folder}: a study needs an analysis.py, or the key `analysis` that names "
                                "another's") from None
        return module


def list_studies() -> dict[str, Study]:
    """All studies of the project, by name."""
    return {name: _load(folder) for name, folder in _list_folders().items()}


def find_study(name: str) -> Study:
    """A study by its name, with hyphens or underscores, or by the path of its folder.

    Raises:
        UnknownNameError: neither; the message names the closest.
        FileReadError: its `study.toml` is damaged.
    """
    if (Path(name) / DEFINITION).is_file():
        return _load(Path(name).resolve())
    known, wanted = _list_folders(), name.replace("_", "-")
    if wanted not in known:
        raise UnknownNameError("study", name, known)
    return _load(known[wanted])


def _list_folders() -> dict[str, Path]:
    """Folders of the project's studies, by name."""
    return {_name(path.parent): path.parent for path in sorted(ROOT.glob(f"*/{DEFINITION}"))}


def _name(folder: Path) -> str:
    return folder.name.replace("_", "-")


def _load(folder: Path) -> Study:
    return Study(folder, read_toml(folder / DEFINITION, "definition of a study"))
