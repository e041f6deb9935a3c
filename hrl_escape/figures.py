"""Figures: their style, their files, and values that notebooks display as figures.

This module does not load matplotlib before it writes a figure, which allows checks of file names first.
"""

from __future__ import annotations

import io
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from hrl_escape.errors import UnsupportedError
from hrl_escape.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
VIDEO_FORMATS = ("gif", "mp4")
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Line colours of Okabe and Ito (2008), which are distinguishable with any colour vision."""
STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "svg.hashsalt": "hrl-escape", "svg.fonttype": "path",
                          "text.parse_math": False}  # names may contain a dollar sign
"""Settings of matplotlib for all figures."""
_UNDATED = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


class Pictured:
    """Base class of values that notebooks display as figures.

    The value must not import the code that draws it. The function is therefore given by its place, `module:function`,
    and maps the value to a matplotlib figure.
    """

    _picture: ClassVar[str]

    def _repr_svg_(self) -> str:
        module, _, function = self._picture.partition(":")
        return make_svg(getattr(import_module(module), function)(self))


def check_picture_name(path: Path, *others: str) -> None:
    """Check that the name of a picture file ends in one of `FORMATS`, or one of `others`."""
    _get_ending(path, *FORMATS, *others)


@cache
def get_figure_class() -> type[Figure]:
    """Return a class of matplotlib figures that notebooks display without a plotting backend."""
    from matplotlib.figure import Figure

    return type("ShownFigure", (Figure,), {"_repr_svg_": make_svg})


def save_figure(path: str | Path, figure: Figure) -> None:
    """Write a figure atomically, in one of `FORMATS` and without a date: equal figures give equal bytes."""
    write_bytes(path, _render(figure, _get_ending(Path(path), *FORMATS)))


def make_svg(figure: Figure) -> str:
    """Return a figure as the text of an SVG picture."""
    return _render(figure, "svg").decode()


def _render(figure: Figure, kind: str) -> bytes:
    import matplotlib
    from matplotlib.backend_bases import get_registered_canvas_class

    content, shown = io.BytesIO(), figure.canvas
    try:
        with matplotlib.rc_context(STYLE):  # `savefig` would draw the figure a second time for its layout
            canvas: Any = get_registered_canvas_class(kind)(figure)
            getattr(canvas, f"print_{kind}")(content, metadata=_UNDATED[kind])
    finally:
        figure.set_canvas(shown)
    return content.getvalue()


def _get_ending(path: Path, *endings: str) -> str:
    kind = path.suffix.lower().lstrip(".")
    if kind not in endings:
        raise UnsupportedError(f"{path}: the name of a picture must end in {', '.join(f'.{each}' for each in endings)}")
    return kind
