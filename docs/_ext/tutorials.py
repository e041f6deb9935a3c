"""Tutorials: scripts that are run as notebooks during the build, shown as pages and offered as downloads.

The module's docstring opens the page, without its title. Comments on lines of their own at the left margin are prose
(Markdown), and the rest is code. Below each piece of code are its printed text and the picture of its last expression.
The last picture also opens the page. A script that fails fails the build.
"""

from __future__ import annotations

import ast
import logging
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from docutils import nodes
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

QUIET = logging.getLogger("tutorials.kernel")
QUIET.setLevel(logging.ERROR)
INSTALL = """# Installs hrl-escape where it is missing, as on Colab. For a checkout, give its folder for the name.
import importlib.util

if importlib.util.find_spec("hrl_escape") is None:
    %pip install -q "{}\""""
EXTRAS = {"minari": "data", "minigrid": "bench"}
"""Packages that tutorials import, and the extra that installs them."""


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


def make_install_cell(source: str) -> str:
    """The first cell of a script's notebook, with the extras that its imports need."""
    statements = list(ast.walk(ast.parse(source)))
    imported = {name.name for node in statements if isinstance(node, ast.Import) for name in node.names}
    imported |= {node.module or "" for node in statements if isinstance(node, ast.ImportFrom)}
    extras = sorted({EXTRAS[top] for name in imported if (top := name.partition(".")[0]) in EXTRAS})
    return INSTALL.format(f"hrl-escape[{','.join(extras)}]" if extras else "hrl-escape")


def make_notebook(script: Path) -> Any:
    """The script as a notebook that was run in an empty folder.

    Raises:
        ExtensionError: a cell failed.
    """
    source = script.read_text(encoding="utf-8")
    title = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0].rstrip(".")
    cells = [nbformat.v4.new_markdown_cell(f"# {title}"), nbformat.v4.new_code_cell(make_install_cell(source))]
    cells += [nbformat.v4.new_markdown_cell(text) if kind == "prose" else nbformat.v4.new_code_cell(text)
              for kind, text in split(source)]
    for number, cell in enumerate(cells):
        cell["id"] = f"{script.stem}-{number}".replace("_", "-")  # the same file each time
    notebook = nbformat.v4.new_notebook(cells=cells)
    with tempfile.TemporaryDirectory() as folder:
        try:
            NotebookClient(notebook, timeout=900, record_timing=False, coalesce_streams=True, log=QUIET,
                           resources={"metadata": {"path": folder}}).execute(
                               stderr=subprocess.DEVNULL, env={**os.environ, "HRL_ESCAPE_PROGRESS": "off"})
        except CellExecutionError as error:
            raise ExtensionError(f"{script.name} failed:\n{error}") from error
    for cell in notebook["cells"]:
        if "outputs" in cell:  # without warnings, and kernels that are compiled the first time
            cell["outputs"] = [output for output in cell["outputs"] if output.get("name") != "stderr"]
    return notebook


def get_picture(output: Any) -> str:
    """HTML of the picture that a cell left; empty where it left none."""
    data = output.get("data", {})
    svg = "".join(data.get("image/svg+xml", "").partition("<svg")[1:])
    return data.get("text/html") or svg


def show_picture(picture: str, *classes: str) -> nodes.Node:
    """A picture as it is in the notebook."""
    return nodes.raw("", f'<div class="{" ".join(("tutorial-picture", *classes))}">{picture}</div>', format="html")


def show_output(output: Any) -> list[nodes.Node]:
    """Return the output of a cell: its text, or the richest form of its last value."""
    if output["output_type"] == "stream":
        return [show_text(output["text"])]
    picture = get_picture(output)
    return [show_picture(picture) if picture else show_text(output["data"]["text/plain"])]


def show_text(text: str) -> nodes.Node:
    """Text as it was printed."""
    return nodes.literal_block(text.rstrip(), text.rstrip(), language="text", classes=["tutorial-output"])


class Tutorial(SphinxDirective):
    """`{tutorial} first_escape.py`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Prose, code, and below each piece of code its output."""
        script = Path(self.env.doc2path(self.env.docname)).parent / self.arguments[0]
        self.env.note_dependency(str(script))
        notebook = make_notebook(script)
        folder = Path(self.env.app.outdir) / "_downloads"
        folder.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, folder / f"{script.stem}.ipynb")
        pictures = [found for cell in notebook["cells"] for output in cell.get("outputs", ())
                    if (found := get_picture(output))]
        shown = [show_picture(pictures[-1], "opening")] if pictures else []
        for cell in notebook["cells"][2:]:  # the page has the title, and its reader the package
            is_prose = cell["cell_type"] == "markdown"
            shown += self.parse_text_to_nodes(cell["source"] if is_prose else f"```python\n{cell['source']}\n```")
            shown += [node for output in cell.get("outputs", ()) for node in show_output(output)]
        link = f'<p><a href="../_downloads/{script.stem}.ipynb" download>Download this page as a notebook</a></p>'
        return [*shown, nodes.raw("", link, format="html"),
                *self.parse_text_to_nodes(f"The whole script: `python docs/tutorials/{script.name}`")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("tutorial", Tutorial)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
