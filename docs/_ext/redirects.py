"""Pages under former addresses, which lead a browser to the present ones."""

from __future__ import annotations

import posixpath
from pathlib import Path

from sphinx.application import Sphinx

MOVED = {
    "schematic": "room-configuration", "api/synthesis": "api/hierarchies", "api/ladder": "api/sets",
    "api/comparison": "api/benchmark", "board": "results/leaderboard", "extend/board": "extend/index",
    **dict.fromkeys(("results/quickstart", "results/price", "results/why", "results/league", "results/flat-ppo"),
                    "results/do-options-help"),
    "results/why-it-worsens": "results/paper", "results/gallery": "puzzles", "results/tools": "tools",
    "results/velocities": "observations",
    **dict.fromkeys(("results/canon", "results/hierarchies", "results/learned", "results/intra-option"),
                    "results/all-algorithms"),
    **dict.fromkeys(("results/parts", "results/buttons", "results/scaling"), "results/learning-structure"),
    **dict.fromkeys(("results/marks", "results/storeys"), "results/unseen-rooms"),
}
"""Former name of each page that has another name now."""


def write_redirects(app: Sphinx, error: Exception | None) -> None:
    """Write a page for each former name, unless the build failed."""
    if error is not None or app.builder.format != "html":
        return
    for old, new in MOVED.items():
        if new not in app.env.found_docs:
            raise ValueError(f"{old} leads to {new}, which is no page")
        target = posixpath.relpath(f"{new}.html", posixpath.dirname(old) or ".")
        page = Path(app.outdir) / f"{old}.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>This page has moved</title>'
                        f'<meta http-equiv="refresh" content="0; url={target}"><link rel="canonical" href="{target}">'
                        f'</head><body><p>This page has moved to <a href="{target}">{target}</a>.</p></body></html>\n',
                        encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages once the others are there."""
    app.connect("build-finished", write_redirects)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
