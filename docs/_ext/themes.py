"""Figures in two themes: where a figure has a variant `NAME-dark.svg`, dark pages show that."""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx


def show_variants(app: Sphinx, document: nodes.document) -> None:
    """Put the dark variant after each image that has one, and show each in its theme alone."""
    folder = Path(document["source"]).parent
    for image in list(document.findall(nodes.image)):
        path = Path(image["uri"])
        dark = path.with_name(f"{path.stem}-dark{path.suffix}")
        if not (folder / dark).is_file():
            continue
        other = image.deepcopy()
        other["uri"] = str(dark)
        image["classes"].append("only-light")
        other["classes"].append("only-dark")
        image.parent.insert(image.parent.index(image) + 1, other)


def setup(app: Sphinx) -> dict[str, bool]:
    """Replace images when a page has been read, before their files are collected."""
    app.connect("doctree-read", show_variants, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
