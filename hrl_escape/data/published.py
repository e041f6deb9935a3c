"""Published recordings: their contents, and the comparison of a recording with the published one of its name.

A recording by another engine version is refused under a published name. Three kinds of difference only give a warning:
a `medium` recording, whose network depends on processor and torch version; a trial with another number of primitives;
and a recording of your own play.
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
    from hrl_escape.data.recording import Recording

PUBLISHED = SHIPPED / "published.toml"
"""Published recordings, a line each; written by `python -m benchmarks.recordings`."""


@dataclasses.dataclass(frozen=True)
class PublishedRecording:
    """Entry of the table of published recordings."""

    content: str  # `Recording.content`
    bytes: int  # size of its file, which depends on the version of zlib
    primitives: int  # in it
    decisions: int  # in it
    episodes: int  # in it
    scores: Mapping[str, float]  # scores of its card, rounded


def read_published() -> Mapping[str, PublishedRecording]:
    """Return the published recordings by name."""
    return _read(PUBLISHED)


@cache
def _read(table: Path) -> Mapping[str, PublishedRecording]:
    return {name: PublishedRecording(**fields) for name, fields in read_toml(table, "table of recordings").items()}


RecordingStanding = Literal["published", "unpublished", "medium", "trial", "played", "other"]
"""Standing of a recording under a name: the published one; a name without one; a full `medium` of another network; a
trial with another number of primitives; your own play; or a difference for another reason."""


class RecordingComparison(NamedTuple):
    """Comparison of a recording with the published one of its name; `difference` describes a differing one."""

    standing: RecordingStanding
    difference: str = ""

    @property
    def fits(self) -> bool:
        """True if the recording can be used under the name."""
        return self.standing in ("published", "unpublished", "medium")

    @property
    def words(self) -> str:
        """Describe the comparison in a clause."""
        known = {"published": "it is the published recording", "unpublished": "no recording of this name is published"}
        return known.get(self.standing, f"it {self.difference}")


def compare_published(name: str, recording: Recording) -> RecordingComparison:
    """Compare a recording with the published one of a name."""
    known = read_published().get(name)
    if known is None:
        return RecordingComparison("unpublished")
    if recording.content == known.content:
        return RecordingComparison("published")
    spec, found = parse_spec(name), _tell_difference(recording, known)
    if recording.about["kind"] == "played":
        return RecordingComparison("played", f"is one's own play and {found}")
    shown = min(len(recording.action), spec.primitives)  # older recordings do not hold the requested number
    if recording.about.get("asked_primitives", shown) != spec.primitives:
        return RecordingComparison("trial", f"is a trial and {found}")
    if spec.kind == "medium":
        return RecordingComparison("medium", f"{found}, for another processor or version of torch may train another "
                                             "network to play it")
    return RecordingComparison("other", found)


def refuse_other(name: str, found: RecordingComparison, path: Path) -> VerificationError:
    """Make the error for a recording that cannot be used under a name."""
    cause = "Another number of primitives or another version of an engine made it. "
    return VerificationError(f"{path}: {name} {found.difference}. {'' if found.standing == 'played' else cause}"
                             "Give its path to use it, or remove it and record again")


def warn_of_other(name: str, recording: Recording, path: Path) -> None:
    """Warn about a trial, your own play, or a different `medium` recording under a published name.

    Raises:
        VerificationError: another version of an engine made it.
    """
    found = compare_published(name, recording)
    if found.standing == "other":
        raise refuse_other(name, found, path)
    if found.standing not in ("published", "unpublished"):
        warnings.warn(f"{name} ({path}): {found.words}", stacklevel=3)


def _tell_difference(recording: Recording, known: PublishedRecording) -> str:
    counts = {"primitives": len(recording.action), "decisions": len(recording.option), "episodes": len(recording.room)}
    differ = [f"{count:,} {what} where that has {getattr(known, what):,}" for what, count in counts.items()
              if count != getattr(known, what)] or ["equal counts but different content"]
    return (f"is not the published recording: it holds {join_words(differ)} (content {recording.content[:12]}, "
            f"published {known.content[:12]})")
