"""Published tapes: what recordings of the catalogue hold that were published, and whether a tape is one of them.

Who records a published data set anew, or loads it by its name, is told where it is another. One that another version of
an engine made is refused under the name; one of `medium` may differ, for a network plays it that another processor or
version of torch may train otherwise, a trial has another number of primitives, and one's own play is none of the
catalogue's: all three are only told.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from hrl_escape.data.catalogue import SHIPPED, parse_spec
from hrl_escape.errors import VerificationError
from hrl_escape.files import read_toml
from hrl_escape.names import join_words

if TYPE_CHECKING:
    from hrl_escape.data.tape import Tape

PUBLISHED = SHIPPED / "published.toml"
"""Published tapes, a line each; written by `python -m benchmarks.tapes`."""


@dataclasses.dataclass(frozen=True)
class PublishedTape:
    """A published tape as it is known before it is recorded here."""

    content: str  # `Tape.content`
    bytes: int  # size of its file; another zlib may give another
    primitives: int  # in it
    decisions: int  # in it
    episodes: int  # in it
    scores: Mapping[str, float]  # those of its card, rounded


def read_published() -> Mapping[str, PublishedTape]:
    """Published tapes, by name; the table is read once."""
    return _read(PUBLISHED)


@cache
def _read(table: Path) -> Mapping[str, PublishedTape]:
    return {name: PublishedTape(**fields) for name, fields in read_toml(table, "table of tapes").items()}


TapeStanding = Literal["published", "unpublished", "medium", "trial", "played", "other"]
"""A tape under a name: the published one; of a name without one; a whole `medium` of another network; recorded with
another number of primitives than the name says; someone's own play; another for other reasons."""


class TapeComparison(NamedTuple):
    """A tape held against the published one of a name; `difference` tells of another one what it is and holds."""

    standing: TapeStanding
    difference: str = ""

    @property
    def fits(self) -> bool:
        """True where the tape may bear the name."""
        return self.standing in ("published", "unpublished", "medium")

    @property
    def words(self) -> str:
        """A clause that tells of it."""
        known = {"published": "it is the published tape", "unpublished": "no tape of this name is published"}
        return known.get(self.standing, f"it {self.difference}")


def compare_published(name: str, tape: Tape) -> TapeComparison:
    """Hold a tape against the published one of a name."""
    known = read_published().get(name)
    if known is None:
        return TapeComparison("unpublished")
    if tape.content == known.content:
        return TapeComparison("published")
    spec, found = parse_spec(name), _tell_difference(tape, known)
    if tape.about["kind"] == "played":
        return TapeComparison("played", f"is one's own play and {found}")
    shown = min(len(tape.action), spec.primitives)  # of an older tape, which does not tell what was asked for
    if tape.about.get("asked_primitives", shown) != spec.primitives:
        return TapeComparison("trial", f"is a trial and {found}")
    if spec.kind == "medium":
        return TapeComparison("medium", f"{found}, for another processor or version of torch may train another network "
                                        "to play it")
    return TapeComparison("other", found)


def refuse_other(name: str, found: TapeComparison, path: Path) -> VerificationError:
    """Make the error for a tape that may not bear a name; it names the file, and what to do."""
    cause = "Another number of primitives or another version of an engine made it. "
    return VerificationError(f"{path}: {name} {found.difference}. {'' if found.standing == 'played' else cause}"
                             "Give its path to use it all the same, or remove it and record anew")


def warn_of_other(name: str, tape: Tape, path: Path) -> None:
    """Warn of a trial, of one's own play, or of a `medium` of another network under the name of a published tape.

    Raises:
        VerificationError: another version of an engine made it.
    """
    found = compare_published(name, tape)
    if found.standing == "other":
        raise refuse_other(name, found, path)
    if found.standing not in ("published", "unpublished"):
        warnings.warn(f"{name} ({path}): {found.words}", stacklevel=3)


def _tell_difference(tape: Tape, known: PublishedTape) -> str:
    counts = {"primitives": len(tape.action), "decisions": len(tape.option), "episodes": len(tape.room)}
    differ = [f"{count:,} {what} where that has {getattr(known, what):,}" for what, count in counts.items()
              if count != getattr(known, what)] or ["equal counts but different content"]
    return (f"is not the published tape: it holds {join_words(differ)} (content {tape.content[:12]}, published "
            f"{known.content[:12]})")
