"""Cards of the result pages: figure, title and the finding, read from the pages themselves.

A page's finding is its first words in bold that make a sentence.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
FEWEST_LETTERS = 30
"""Letters of the shortest finding; names in bold are shorter."""


class Finding(NamedTuple):
    """What a card shows.

    Attributes:
        page: name of the page.
        title: its heading.
        text: one or two sentences, Markdown.
        figure: path of its first figure; empty for none.
    """

    page: str
    title: str
    text: str
    figure: str


def read_finding(page: str) -> Finding:
    """Read a page.

    Raises:
        ValueError: it states no finding.
    """
    text = (RESULTS / f"{page}.md").read_text(encoding="utf-8")
    title = text.partition("\n")[0].removeprefix("# ")
    bold = [found for found in re.findall(r"\*\*(.+?)\*\*", text) if len(found) >= FEWEST_LETTERS]
    if not bold:
        raise ValueError(f"docs/results/{page}.md states no finding in bold")
    figure = re.search(r"!\[[^\]]*\]\((\S+)\)", text)
    return Finding(page, title, bold[0], figure[1] if figure else "")


def write_card(finding: Finding) -> str:
    """Markdown of a card."""
    picture = f"[![{finding.title}]({finding.figure})]({finding.page}.md)\n\n" if finding.figure else ""
    return f":::{{container}} finding-card\n{picture}**[{finding.title}]({finding.page}.md)**\n\n{finding.text}\n:::\n"


class Findings(SphinxDirective):
    """`{findings}`: a card for each page that the content names. The index has to name every page once."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Read the pages and make their cards."""
        index = (RESULTS / "index.md").read_text(encoding="utf-8")
        named = [page for block in re.findall(r"```\{findings\}\n(.*?)```", index, re.DOTALL) for page in block.split()]
        if sorted(named) != (found := sorted({path.stem for path in RESULTS.glob("*.md")} - {"index"})):
            raise self.error(f"pages of results: {found}, named are {sorted(named)}")
        cards = "\n".join(write_card(read_finding(page)) for page in self.content)
        return self.parse_text_to_nodes(f"::::{{container}} findings\n{cards}\n::::\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("findings", Findings)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
