"""Reference of a package: one entry for each name that it exports, the important ones first."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Sequence
from types import ModuleType

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import make_table


def write_entry(package: ModuleType, name: str) -> list[str]:
    """The autodoc directive for one public name, as lines of reStructuredText."""
    thing = getattr(package, name)
    path = f"{package.__name__}.{name}"
    if inspect.isclass(thing):
        return [f".. autoclass:: {path}", "   :members:", "   :show-inheritance:", ""]
    if inspect.isroutine(thing):
        return [f".. autofunction:: {path}", ""]
    return [f".. py:data:: {path}", f"   :type: {type(thing).__name__}", ""]


class Api(SphinxDirective):
    """`{api} hrl_escape.env`: a table "to do X, call Y", then the entries in the order of the table, then the rest.

    A line of the content is `what to do | Call("arguments")`; the call begins with a public name of the package.
    """

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Write and parse."""
        package = importlib.import_module(self.arguments[0])
        rows, first = [], []
        for line in filter(None, self.content):
            task, _, call = (part.strip() for part in line.partition(" | "))
            name = re.split(r"\W", call)[0]
            if name not in package.__all__:
                raise self.error(f"{package.__name__} has no public name {name!r}")
            rows.append((task, f"{{py:obj}}`{call} <{package.__name__}.{name}>`"))
            first += [] if name in first else [name]
        rest = sorted(set(package.__all__) - set(first), key=str.lower)
        return self.parse_text_to_nodes("\n\n".join((
            make_table(("to", "call"), rows), write_entries(package, first),
            *(("```{rubric} Further names\n:heading-level: 2\n```", write_entries(package, rest)) if rest else ()))))


def write_entries(package: ModuleType, names: Sequence[str]) -> str:
    """Entries of names as Markdown."""
    return "\n".join(["```{eval-rst}", *(line for name in names for line in write_entry(package, name)), "```"])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("api", Api)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
