"""Progress of long work, on standard error: a bar in terminals and notebooks, a line a minute in logs.

    with show_progress("smdp-dqn seed 0", total=20_000) as report:
        for primitives in ...:
            report(primitives, "return -31.2")

The line holds the amount done, the rate, the time left and the words of the caller. `HRL_ESCAPE_PROGRESS=off` in the
environment turns every progress line off, also where `show=True` asks for one.
"""

from __future__ import annotations

import html
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeAlias

from rich.console import Console
from rich.live import Live
from rich.text import Text

REFRESH_SECONDS, LOG_SECONDS = 0.2, 60.0
"""Seconds between updates of a bar, and between lines in a log."""
SWITCH = "HRL_ESCAPE_PROGRESS"
"""Environment variable; `off` hides every progress line."""
BAR_WIDTH = 6

Reporter: TypeAlias = Callable[[float, str], None]
"""Takes the amount done so far, in units of the total, and words such as the latest returns."""


class Display(Protocol):
    """Place where a progress line is shown."""

    seconds: float  # between two updates

    def show(self, line: str, share: float) -> None:
        """Show a line; `share` is the part that is done, 0 to 1."""
        ...

    def close(self, line: str, share: float) -> None:
        """Show the last line, which stays."""
        ...


class TerminalDisplay:
    """Line at the bottom of a terminal; other output of the process appears above it."""

    seconds = REFRESH_SECONDS

    def __init__(self, console: Console, stays: bool = True) -> None:
        self._live = Live(console=console, refresh_per_second=1 / REFRESH_SECONDS, transient=not stays)
        self._live.start()

    def show(self, line: str, share: float) -> None:
        """Replace the line; what does not fit the width is cut off at its end."""
        done = round(share * BAR_WIDTH)
        bar = Text("━" * done, style="green").append("━" * (BAR_WIDTH - done), style="dim")
        self._live.update(Text.assemble(bar, " ", line, no_wrap=True, overflow="ellipsis"))

    def close(self, line: str, share: float) -> None:
        """Leave the last line, or remove it."""
        self.show(line, share)
        self._live.stop()


class NotebookDisplay:
    """Bar below a notebook's cell, without widgets; its last state stays in the saved notebook, with a plain text."""

    seconds = 5 * REFRESH_SECONDS

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, line: str, share: float) -> None:
        """Replace the bar."""
        from IPython.display import display

        bundle = {"text/html": f'<progress value="{share:.4f}" max="1"></progress> {html.escape(line)}',
                  "text/plain": line}
        if self._handle is None:
            self._handle = display(bundle, raw=True, display_id=True)
        else:
            self._handle.update(bundle, raw=True)

    close = show


class LogDisplay:
    """Lines in a log. Work of less than a minute leaves none unless `always` asks for its last one."""

    seconds = LOG_SECONDS

    def __init__(self, console: Console, always: bool) -> None:
        self._console, self._writes_last = console, always

    def show(self, line: str, share: float) -> None:
        """Write a line."""
        del share
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        self._writes_last = True

    def close(self, line: str, share: float) -> None:
        """Write the last line, if there were others."""
        if self._writes_last:
            self.show(line, share)


@contextmanager
def show_progress(name: str, total: float, done: float = 0, show: bool | None = None, *,
                  console: Console | None = None, stays: bool = True) -> Iterator[Reporter]:
    """Show the progress of the body of a `with` statement.

    Args:
        name: of the work.
        total: amount of work, in primitives.
        done: amount that an earlier call has done.
        show: False for no line. True also writes the last line of short work to a log. None shows a bar in terminals
            and notebooks, and a line a minute elsewhere.
        console: where to write, by default standard error.
        stays: whether a terminal keeps the last line.

    Yields:
        Function that takes the amount done so far and words. It can be called as often as one likes.
    """
    display = _choose_display(show, console or Console(stderr=True), stays)
    if display is None:
        yield lambda done, words: None
        return
    last = started = time.monotonic()
    latest = done, "resumed" if done else ""

    def make_line(now: float) -> str:
        amount, words = latest
        rate = (amount - done) / max(now - started, 1e-9)
        left = math.inf if rate <= 0 else max(total - amount, 0) / rate
        count, speed = f"{min(amount, total):,.0f}/{total:,.0f}", f"{rate:,.0f}/s"
        return " ".join(filter(None, (name, count, speed, _format_left(left), words)))

    def compute_share() -> float:
        return min(latest[0] / total, 1.0) if total else 1.0

    def report(amount: float, words: str) -> None:
        nonlocal last, latest
        now, latest = time.monotonic(), (amount, words)
        if now - last >= display.seconds:
            last = now
            display.show(make_line(now), compute_share())

    try:
        yield report
    finally:
        display.close(make_line(time.monotonic()), compute_share())


def describe_results(returns: Sequence[float], successes: Sequence[float | None] = ()) -> str:
    """Describe recent episodes for a progress line, such as `return -31.2 success 40%`.

    Args:
        returns: returns of episodes, or means of several.
        successes: success, or success rate, of the same; None or NaN where an environment reports none.
    """
    known = [each for each in successes if each is not None and not math.isnan(each)]
    words = [f"return {sum(returns) / len(returns):.1f}"] if returns else []
    return " ".join(words + ([f"success {sum(known) / len(known):.0%}"] if known else []))


def _choose_display(show: bool | None, console: Console, stays: bool) -> Display | None:
    if show is False or os.environ.get(SWITCH, "").lower() in ("off", "0"):
        return None
    if _is_notebook():
        return NotebookDisplay()
    return TerminalDisplay(console, stays) if console.is_terminal else LogDisplay(console, show is True)


def _is_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    return getattr(ipython.get_ipython(), "kernel", None) is not None if ipython is not None else False


def _format_left(seconds: float) -> str:
    """Format the time left as `1:02:03 left`; empty if it is unknown."""
    if not math.isfinite(seconds):
        return ""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02} left" if hours else f"{minutes}:{rest:02} left"
