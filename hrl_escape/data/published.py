"""Published tapes: what recordings of the catalogue hold that were published, and whether a tape is one of them.

Who records a published data set anew, or loads it by its name, is told where it is another. One that another version of
an engine made is refused under the name; one of `medium` may differ, for a network plays it that another processor or
version of torch may train otherwise, and a trial has fewer primitives: both are only told.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hrl_escape.data.catalogue import SHIPPED, DataSpec, parse_spec
from hrl_escape.errors import VerificationError
from hrl_escape.files import read_toml
from hrl_escape.names import join_words

if TYPE_CHECKING:
    from hrl_escape.data.tape import Tape

PUBLISHED = SHIPPED / "published.toml"
"""Published tapes, a line each; written by `python -m benchmarks.tapes`."""


@dataclasses.dataclass(frozen=True)
class PublishedTape:
    """A published tape as it is known before it is recorded here.

    Attributes:
        content: `Tape.content`.
        bytes: size of its file; another zlib may give another.
        primitives: in it.
        decisions: in it.
        episodes: in it.
        scores: those of its card, rounded.
    """

    content: str
    bytes: int
    primitives: int
    decisions: int
    episodes: int
    scores: Mapping[str, float]


def read_published() -> Mapping[str, PublishedTape]:
    """Published tapes, by name; the table is read once."""
    return _read(PUBLISHED)


@cache
def _read(table: Path) -> Mapping[str, PublishedTape]:
    return {name: PublishedTape(**fields) for name, fields in read_toml(table, "table of tapes").items()}


def fits_published(spec: DataSpec, tape: Tape) -> bool:
    """Return whether a tape may bear a data set's name: none is published, it is that one, or a whole `medium`."""
    known = read_published().get(spec.name)
    return known is None or tape.content == known.content or (
        spec.kind == "medium" and len(tape.action) >= spec.primitives)


def compare_published(spec: DataSpec, tape: Tape, path: Path) -> str:
    """Words for a tape that may bear the name of a data set.

    Raises:
        VerificationError: it may not; the message names its file, and what to do.
    """
    known = read_published().get(spec.name)
    if known is None:
        return "no tape of this name is published"
    if tape.content == known.content:
        return "it is the published tape"
    found = _tell_difference(tape, known)
    if fits_published(spec, tape):
        return f"it {found}, for another processor or version of torch may train another network to play it"
    raise VerificationError(f"{path}: {spec.name} {found}. Another number of primitives or another version of an "
                            "engine made it. Give its path to use it all the same, or remove it and record anew")


def warn_of_other(name: str, tape: Tape, path: Path) -> None:
    """Warn of a trial, or of a `medium` of another network, that is loaded by the name of a published tape.

    Raises:
        VerificationError: another version of an engine made it.
    """
    known = read_published().get(name)
    if known is None or tape.content == known.content:
        return
    spec = parse_spec(name)
    is_trial = len(tape.action) < spec.primitives
    told = f"it is a trial and {_tell_difference(tape, known)}" if is_trial else compare_published(spec, tape, path)
    warnings.warn(f"{name} ({path}): {told}", stacklevel=3)


def _tell_difference(tape: Tape, known: PublishedTape) -> str:
    counts = {"primitives": len(tape.action), "decisions": len(tape.option), "episodes": len(tape.room)}
    differ = [f"{count:,} {what} where that has {getattr(known, what):,}" for what, count in counts.items()
              if count != getattr(known, what)] or ["as much, and different in content"]
    return (f"is not the published tape: it holds {join_words(differ)} (content {tape.content[:12]}, published "
            f"{known.content[:12]})")
