"""Safe file names and console text from names of rooms, grids and agents; lists, numbers and durations as text.

Names come from files of unknown origin. They may contain `../`, line breaks, 300 letters or a terminal's escape codes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

LONGEST_FILE_NAME = 120
"""Most bytes of a file name made from a name. File systems allow 255, ending included."""
LONGEST_CONSOLE_TEXT = 100
"""Most characters of a name on a console."""


def make_file_name(name: str) -> str:
    """Make a name of a file or folder: no separators, no leading dot, at most `LONGEST_FILE_NAME` bytes.

    A name that had to change ends in a hash of the original, which keeps different names different.
    """
    safe = re.sub(r"[^\w.@#+-]+", "_", name).lstrip(".")
    if safe == name and name and len(name.encode()) <= LONGEST_FILE_NAME:
        return name
    key = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:8]
    short = safe.encode()[: LONGEST_FILE_NAME - 1 - len(key)].decode(errors="ignore")
    return f"{short}-{key}" if short else key


def make_console_text(name: str, longest: int = LONGEST_CONSOLE_TEXT) -> str:
    """Make a safe part of a line that rich prints: no markup, no control characters, at most `longest` characters."""
    from rich import markup  # imported here because `hrl-escape --help` does not need it

    shown = name if len(name) <= longest else f"{name[: longest - 3]}..."
    plain = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in shown)
    return markup.escape(plain)


def make_markdown_text(text: str) -> str:
    """Make a text that Markdown shows as it is, on one line and within a cell of a table, without tags and links.

    Pairs of backticks stay, and mark code.
    """
    plain = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    safe = plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\|\[\]])", r"\\\1", safe)


def parse_whole(text: str) -> int | None:
    """Return the number in a name such as `clutter#3`: at most 18 digits, 0 to 9, or None for any other text."""
    return int(text) if re.fullmatch("[0-9]{1,18}", text) else None


def join_words(words: Iterable[str], last: str = "and") -> str:
    """Join words as in a sentence: `a`, `a and b`, `a, b and c`; empty for no words."""
    *before, end = list(words) or [""]
    return f"{', '.join(before)} {last} {end}" if before else end


def number_options(count: int) -> tuple[str, ...]:
    """Return keys of a room's options by number, the exit's last: `meta-01`, `meta-02`, `meta-exit`.

    Random draws of degraded options and hashes of published recordings depend on these keys, not on option names.
    """
    return (*(f"meta-{number:02d}" for number in range(1, count)), "meta-exit") if count else ()


def count_nouns(number: int, noun: str) -> str:
    """Return number and noun: `1 room`, `2 rooms`, `1,000 rooms`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def tell_seconds(seconds: float) -> str:
    """Return a duration with its unit: `3.2 s`, `45 s`, `15 min` or `2 h 5 min`."""
    if round(seconds) < 90:
        return f"{seconds:.1f} s" if round(seconds, 1) < 10 else f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
