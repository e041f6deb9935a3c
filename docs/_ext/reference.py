"""The reference reads docstrings, which are written in Markdown with Google's sections.

What reStructuredText would misread is rewritten before autodoc sees it: tables, headings,
links, and paragraphs that stand under a field of a dataclass.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

TABLE = re.compile(r"^\s*\|.*\|\s*$")
HEADING = re.compile(r"^#+ (.+)$")
LINK = re.compile(r"\[([^\]]+)\]\((https?://[^)]+)\)")


def rewrite(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Turn a docstring's Markdown into reStructuredText, in place."""
    del app, what, name, thing, options
    written: list[str] = []
    number = 0
    while number < len(lines):
        line = lines[number]
        if TABLE.match(line):
            block = []
            while number < len(lines) and TABLE.match(lines[number]):
                block.append(lines[number])
                number += 1
            written += ["", *write_table(block), ""]
            continue
        heading = HEADING.match(line)
        line = f"**{heading[1]}**" if heading else LINK.sub(r"`\1 <\2>`__", line)
        line = re.sub(r"\|(\w+)\|", r"\\|\1\\|", line)  # an absolute value, not a substitution
        line = re.sub(r"(?<=[(,] )\*(?=\w[^*]*$)|(?<=\()\*(?=\w[^*]*$)", r"\\*", line)  # unpacking, not emphasis
        written.append(line)
        if heading:
            written.append("")
        number += 1
    lines[:] = written


def write_table(block: list[str]) -> list[str]:
    """A Markdown table as a list-table."""
    indent = re.match(r"\s*", block[0])
    margin = indent[0] if indent else ""
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in block]
    head, _, *body = rows
    written = [f"{margin}.. list-table::", f"{margin}   :header-rows: 1", ""]
    for row in (head, *body):
        written += [f"{margin}   {'* -' if number == 0 else '  -'} {cell}" for number, cell in enumerate(row)]
    return written


def skip(app: Sphinx, what: str, name: str, thing: Any, skipped: bool, options: Any) -> bool | None:
    """Leave a NamedTuple's fields out: its docstring lists them."""
    del app, what, name, skipped, options
    return True if type(thing).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Hook in before napoleon reads the sections."""
    app.connect("autodoc-process-docstring", rewrite, priority=100)
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
