"""Writer of pages: a study's template, filled with the results of its analysis, and its figures next to it.

Templates have one paragraph a line. Besides the values of the analysis they see the `study`, and filters: `words`
joins a list as a sentence does, `code` sets each in code, `count` puts a noun behind a number, `num` formats one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jinja2

from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.figures import save_figure
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words
from studies.study import ROOT, Page, Study

__all__ = ["make_table", "render", "write_page"]


def write_page(study: Study, page: Page, docs: Path) -> Page:
    """Write a study's page into a folder, and figures and files into its `figures`.

    Raises:
        FileWriteError: a file cannot be written.
    """
    for name, figure in page.figures.items():
        save_figure(docs / "figures" / (name if "." in name else f"{name}.svg"), figure)
    for name, text in page.files.items():
        write_text(docs / "figures" / name, text)
    write_text(docs / f"{study.page}.md", render(study, page))
    return page


def render(study: Study, page: Page) -> str:
    """Text of a study's page."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([study.folder, ROOT]), undefined=jinja2.StrictUndefined, autoescape=False,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    environment.filters |= {"words": join_words, "code": _set_in_code, "count": count_nouns, "num": format}
    environment.globals |= {"table": make_table, "study": study, "LEAST_RUNS": LEAST_RUNS}
    return environment.get_template("page.md.j2").render(page.values)


def make_table(header: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown, without a line break at its end."""
    head = "".join(f" {cell} |" if cell else " |" for cell in map(str, header))
    return "\n".join([f"|{head}", f"|{'---|' * len(header)}",
                      *(f"| {' | '.join(map(str, row))} |" for row in rows)])


def _set_in_code(names: Iterable[str]) -> list[str]:
    return [f"`{name}`" for name in names]
