"""HTML that notebooks show for values of the package: tables and sentences, without scripts and styles of their own.

GitHub shows such HTML as it is. It removes frames, so a value with a moving map also has a caption and a still picture,
which printed notebooks use.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

MOST_ROWS = 40
"""Rows of a table before it is abbreviated."""


def make_html_table(headings: Sequence[str], rows: Sequence[Sequence[object]], most: int = MOST_ROWS) -> str:
    """Make a table; rows beyond `most` are counted in a last line."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in headings)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows[:most])
    left = len(rows) - most
    more = f'<tr><td colspan="{len(headings)}">and {left:,} more</td></tr>' if left > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}{more}</tbody></table>"


def mark_labels(text: str) -> str:
    """Escape a sentence, and set names between backticks in code font."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text))


def make_caption(picture: str, caption: str) -> str:
    """Put a caption below a picture."""
    return f"<figure>{picture}<figcaption>{html.escape(caption)}</figcaption></figure>"
