"""Progress line of a training run: primitives, rate, returns, time left.

It is shown on terminals only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

REFRESH_SECONDS = 0.2


Reporter = Callable[[int, str], None]
"""Takes the progress of a run: primitives so far, and the latest returns in words."""


@contextmanager
def show_progress(name: str, total: int, done: int, show: bool | None) -> Iterator[Reporter]:
    """Show a line on standard error while training up to `total` primitives; with `show=None` on a terminal only."""
    console = Console(stderr=True)
    if not (console.is_terminal if show is None else show):
        yield lambda primitives, words: None
        return
    columns = (  # fits 80 characters
        TextColumn("{task.description}"),
        BarColumn(bar_width=8),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}"),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[words]}"),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=console) as progress:
        if done:
            console.print(f"{name} goes on from primitive {done:,}", markup=False)
        task = progress.add_task(name, total=total, completed=done, rate="", words="")
        started = last = time.monotonic()
        latest = done, ""

        def refresh() -> None:
            primitives, words = latest
            rate = (primitives - done) / max(last - started, 1e-9)
            progress.update(task, completed=min(primitives, total), rate=f"{rate:,.0f}/s", words=words)

        def report(primitives: int, words: str) -> None:
            nonlocal last, latest
            now, latest = time.monotonic(), (primitives, words)
            if now - last >= REFRESH_SECONDS:
                last = now
                refresh()

        try:
            yield report
        finally:  # the line that stays
            last = time.monotonic()
            refresh()
