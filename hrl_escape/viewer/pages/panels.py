"""HTML of the control panel: the puzzle's graph, tables and bars. Pure functions from values to text."""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from markupsafe import escape

from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.graph import compute_layout, shorten
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin

WIDTH = 350
"""Width of the control panel's drawings, pixels."""
_STYLE = "font-family:Inter,system-ui,sans-serif;font-size:13px;color:#22262e;margin:0 0.75em 0.6em"


class KnownEdges(NamedTuple):
    """Known or believed edges of a graph, drawn instead of the true edges."""

    known: Collection[tuple[int, int]] = ()  # certain edges (parent, child)
    possible: Collection[tuple[int, int]] = ()  # possible edges, drawn dashed


def make_graph(puzzle: Puzzle, state: Hashable, width: int = WIDTH, believed: KnownEdges | None = None,
               is_hidden: bool = False, drawing: str = "puzzle") -> str:
    """Return the puzzle's graph as SVG, `width` pixels wide, with lit targets and a second ring around the goal.

    Edges in `believed` replace the true ones; wrong ones are red. If the graph `is_hidden`, nodes are on a ring, and
    positions and colours are independent of the true graph. `drawing` is the id of the SVG in the page.
    """
    graph = get_mixin(puzzle, Graphed)
    edges = graph.edges if believed is None else sorted({*believed.known, *believed.possible})
    count = len(puzzle.target_names)
    places = _place_on_ring(count) if is_hidden else compute_layout(count, graph.edges)
    columns = max((x for x, _ in places), default=0.0) + 1
    rows = max((y for _, y in places), default=0.0) + 1
    cell = min(62.0, (width - 20) / columns)
    radius = 0.3 * cell
    left, top = (width - cell * columns) / 2 + cell / 2, cell / 2
    at = [(left + cell * x, top + cell * y) for x, y in places]
    lit = puzzle.get_lit(state)
    parts = []
    for parent, child in edges:
        (x0, y0), (x1, y1) = at[parent], at[child]
        length = max(((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5, 1.0)
        gap = (radius + 4) / length
        colour = palette.MUTED if is_hidden or (parent, child) in graph.edges else palette.LOCK
        dashes = "" if believed is None or (parent, child) in believed.known else ' stroke-dasharray="3 3"'
        parts.append(f'<line class="edge" data-edge="{parent}-{child}" x1="{x0 + gap * (x1 - x0):.1f}" '
                     f'y1="{y0 + gap * (y1 - y0):.1f}" x2="{x1 - gap * (x1 - x0):.1f}" '
                     f'y2="{y1 - gap * (y1 - y0):.1f}" stroke="{colour}" stroke-width="1.4"{dashes} '
                     'marker-end="url(#arrow)"/>')
    for node, (x, y) in enumerate(at):
        fill, edge, ink = palette.get_target_look(puzzle, state, node, is_hidden)
        name = puzzle.target_names[node]
        if lit[node]:
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius + 7:.1f}" fill="{fill}" opacity="0.3"/>')
        if node in graph.goal_targets and not is_hidden:
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius + 4:.1f}" fill="none" stroke="{edge}" '
                         'stroke-width="1.5"/>')
        parts.append(f'<circle class="node" data-name="{escape(name)}" data-lit="{int(lit[node])}" cx="{x:.1f}" '
                     f'cy="{y:.1f}" r="{radius:.1f}" fill="{fill}" stroke="{edge}" stroke-width="1.2"/>'
                     f'<text x="{x:.1f}" y="{y:.1f}" fill="{ink}" font-size="{min(15.0, 0.26 * cell):.1f}" '
                     f'text-anchor="middle" dominant-baseline="central">{escape(shorten(name))}</text>')
    arrow = ('<defs><marker id="arrow" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="7" markerHeight="7" '
             f'orient="auto"><path d="M0 0L8 4L0 8z" fill="{palette.MUTED}"/></marker></defs>')
    high = cell * rows + 8
    return (f'<div style="{_STYLE}"><svg id="{drawing}" width="{width}" height="{high:.0f}" '
            f'viewBox="0 -4 {width} {high:.0f}" style="font-family:inherit;max-width:100%;height:auto">'
            f'{arrow}{"".join(parts)}</svg></div>')


def make_pair(*drawings: tuple[str, str]) -> str:
    """Return drawings in a row, each with a title above. The HTML of the drawings is not escaped."""
    return f'<div style="{_STYLE};font-size:12px;display:flex;gap:6px">' + "".join(
        f'<div class="belief" style="flex:1 1 0;min-width:0;text-align:center"><div style="color:{palette.MUTED}">'
        f"{escape(words)}</div>{drawing.replace(_STYLE, '')}</div>" for words, drawing in drawings) + "</div>"


def _place_on_ring(count: int) -> list[tuple[float, float]]:
    """Positions of nodes on a ring, clockwise from the top, with a distance of at least 1 between neighbours."""
    radius = 0.5 / math.sin(math.pi / count) if count > 1 else 0.0
    return [(radius * (1 + math.sin(math.tau * i / count)), radius * (1 - math.cos(math.tau * i / count)))
            for i in range(count)]


def make_facts(facts: Iterable[tuple[str, str]], note: str = "", **data: object) -> str:
    """Return a row of large numbers with their names, and a note below."""
    tags = "".join(f' data-{name}="{escape(str(value))}"' for name, value in data.items())
    cells = "".join(f'<div style="flex:1 1 0;min-width:0"><div style="color:{palette.MUTED};font-size:11px">'
                    f'{escape(name)}</div><div style="font-size:19px;font-weight:600;'
                    f'font-variant-numeric:tabular-nums">{escape(value)}</div></div>' for name, value in facts)
    line = f'<div style="min-height:3em;line-height:1.5;margin-top:4px">{escape(note)}</div>'
    return f'<div id="facts"{tags} style="{_STYLE}"><div style="display:flex;gap:8px">{cells}</div>{line}</div>'


def make_keys(keys: Iterable[tuple[str, str]]) -> str:
    """Return a table of keys and their meanings."""
    rows = "".join('<div style="display:flex;gap:8px;break-inside:avoid;line-height:1.75"><span style="flex:0 0 5.6em">'
                   + " ".join('<kbd style="border:1px solid #c8ccd4;border-radius:3px;padding:0 4px;font-size:11px;'
                              f'background:#f6f7f9">{escape(key)}</kbd>' for key in names.split())
                   + f"</span><span>{escape(meaning)}</span></div>" for names, meaning in keys)
    return f'<div style="{_STYLE};font-size:12px;columns:2;column-gap:10px">{rows}</div>'


def make_table(header: Sequence[str], rows: Iterable[Sequence[str]], name: str = "", empty: str = "") -> str:
    """Return a small table; the first column is text, the others are numbers."""
    heads = "".join(f'<th style="text-align:{"left" if i == 0 else "right"};font-weight:500;color:{palette.MUTED};'
                    f'padding:1px 4px">{escape(text)}</th>' for i, text in enumerate(header))
    body = "".join("<tr>" + "".join(f'<td style="text-align:{"left" if i == 0 else "right"};padding:1px 4px;'
                                    f'white-space:nowrap">{escape(text)}</td>' for i, text in enumerate(row)) + "</tr>"
                   for row in rows)
    body = body or f'<tr><td colspan="{len(header)}" style="color:{palette.MUTED}">{escape(empty)}</td></tr>'
    return (f'<div id="{name}" style="{_STYLE};font-size:12px"><table style="border-collapse:collapse;width:100%;'
            f'font-variant-numeric:tabular-nums"><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>')


def make_bars(names: Sequence[str], values: Any, mask: Sequence[bool] | Any, chosen: int, meaning: str,
              notes: Mapping[int, str] | None = None) -> str:
    """Return actions with their values, if any, as bars. The chosen action is marked; illegal ones are grey.

    `meaning` is `value`, `preference`, `note`, or empty without values. `notes` replace the numbers of actions, by
    action.
    """
    notes = notes or {}
    legal = [bool(on) for on in mask]
    numbers = [None] * len(names) if values is None else [float(value) for value in values]
    shown = [value for value, on in zip(numbers, legal, strict=True) if on and value is not None]
    low, high = min(shown, default=0.0), max(shown, default=0.0)
    rows = []
    for index, name in enumerate(names):
        value, on = numbers[index], legal[index]
        share = (value - low) / (high - low) if value is not None and on and high > low else 0.0
        ink = palette.INK if on else "#b4b8c0"
        mark = "\N{BLACK RIGHT-POINTING TRIANGLE}" if index == chosen else ""
        text = ("" if value is None else f"{value:.3f}") if on else "masked"
        flex = "0 0 5em" if index not in notes else "0 1 auto"
        text = escape(notes[index]) if index in notes and on else text
        weight = 700 if index == chosen else 400
        number = "" if value is None else repr(value)
        rows.append(
            f'<div class="action" data-name="{escape(name)}" data-legal="{int(on)}" data-value="{number}" '
            f'data-chosen="{int(index == chosen)}" style="display:flex;gap:6px;line-height:1.55;color:{ink};'
            f'font-weight:{weight}"><span style="flex:0 0 1em;color:#d55e00">{mark}</span>'
            f'<span style="flex:0 0 9.5em">{escape(name)}</span><span style="flex:1 1 auto"><span style="display:'
            f'inline-block;height:8px;border-radius:2px;background:{palette.BODY};opacity:0.75;'
            f'width:{100 * share:.0f}%"></span></span><span style="flex:{flex};text-align:right;'
            f'font-variant-numeric:tabular-nums">{text}</span>'
            "</div>"
        )
    about = {"value": "action values Q(s, \N{MIDDLE DOT}), in units of return",
             "preference": "preferences of the policy", "note": "notes of this driver on each press",
             "": "this driver computes no values"}[meaning]
    return (f'<div id="values" style="{_STYLE};font-size:12px"><div style="color:{palette.MUTED}">{about}</div>'
            f'{"".join(rows)}</div>')


def make_lines(lines: Iterable[str], name: str = "") -> str:
    """Return lines of text, one below another; `Markup` among them is not escaped."""
    return f'<div id="{name}" style="{_STYLE};font-size:12px;line-height:1.6">' + "".join(
        f"<div>{escape(line)}</div>" for line in lines) + "</div>"
