"""`{api} hrl_escape.env`: the reference of a package, one entry for each public name.

The names are those that the package exports, so nothing public is missing and nothing else is there.
"""

from __future__ import annotations

import importlib
import inspect
from types import ModuleType

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


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
    """A directive that is replaced by the reference of a package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write and parse."""
        package = importlib.import_module(self.arguments[0])
        lines = [line for name in sorted(package.__all__, key=str.lower) for line in write_entry(package, name)]
        return self.parse_text_to_nodes("\n".join(["```{eval-rst}", *lines, "```"]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("api", Api)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
