"""Tutorials: a script becomes a page, and its output is what it prints when the site is built.

The module's docstring, its title left out, opens the page; comments that stand alone at the left margin are prose
(Markdown); the rest is code. A script that fails fails the build.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tempfile
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective


def split(source: str) -> list[tuple[str, str]]:
    """A script's parts in order: ("prose", Markdown) or ("code", Python)."""
    tree = ast.parse(source)
    document = (ast.get_docstring(tree) or "").partition("\n")[2]  # the title is the page's
    parts: list[tuple[str, list[str]]] = [("prose", [document])]
    inside = {number for node in tree.body for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    for number, line in enumerate(source.splitlines(), 1):
        if number <= (tree.body[0].end_lineno or 1):
            continue
        kind = "prose" if line.startswith("#") and number not in inside else "code"
        text = line.removeprefix("#").removeprefix(" ") if kind == "prose" else line
        if kind != parts[-1][0] and (line or kind == "prose"):
            parts.append((kind, []))
        parts[-1][1].append(text)
    joined = [(kind, "\n".join(lines).strip("\n")) for kind, lines in parts]
    return [(kind, text) for kind, text in joined if text]


def run(script: Path) -> str:
    """What a script prints, run in an empty folder.

    Raises:
        ExtensionError: it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, script], cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise ExtensionError(f"{script.name} failed:\n{done.stderr}")
    return done.stdout


class Tutorial(SphinxDirective):
    """`{tutorial} first_escape.py`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Prose, code, and at the end the output."""
        script = Path(self.env.doc2path(self.env.docname)).parent / self.arguments[0]
        self.env.note_dependency(str(script))
        text = []
        for kind, part in split(script.read_text(encoding="utf-8")):
            text.append(part if kind == "prose" else f"```python\n{part}\n```")
        text.append(f"It prints:\n\n```{{code-block}} text\n:class: tutorial-output\n{run(script).rstrip()}\n```")
        text.append(f"The whole script: `python docs/tutorials/{script.name}`")
        return self.parse_text_to_nodes("\n\n".join(text))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("tutorial", Tutorial)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
