"""Catalogue of data sets: eight rungs of `ladder-1`, six kinds of behaviour, three sizes.

`lattice-play-v1` has 10^5 primitives and comes with the package. `lattice-play-1m-v1` has 10^6 and
`lattice-play-10m-v1` 10^7; `hrl-escape data make NAME` records them.
"""

from __future__ import annotations

import dataclasses
import re
from importlib.resources import files
from pathlib import Path

from hrl_escape.errors import FileReadError, UnknownNameError

BENCHMARK = "ladder-1"
RUNGS = ("pair", "chain", "lattice-5", "lattice", "clutter", "code", "freight", "reach")
RECORDING_KINDS = {
    "play": "legal options, drawn uniformly",
    "noisy": "as play, and one option in five fails at its start",
    "expert": "the oracle's options",
    "medium": "a learner at half of the oracle's efficiency, with one random choice in ten",
    "stitch": "play in trajectories of one or two decisions",
    "explore": "primitives, drawn uniformly",
}
RECORDING_SIZES = {"": 100_000, "1m": 1_000_000, "10m": 10_000_000}
FOLDER = Path("data")
"""Folder of recordings made here."""
SHIPPED = Path(str(files("hrl_escape.data") / "recordings"))
"""Folder of the recordings that come with the package."""
_FORM = re.compile(rf"(?P<rung>.+)-(?P<kind>{'|'.join(RECORDING_KINDS)})(?:-(?P<size>1m|10m))?-v1")


@dataclasses.dataclass(frozen=True)
class DataSpec:
    """Data set of the catalogue: a rung of `ladder-1`, one of `RECORDING_KINDS`, and one of `RECORDING_SIZES`."""

    rung: str
    kind: str
    size: str = ""

    @property
    def name(self) -> str:
        """Name of the data set, such as `lattice-play-v1`."""
        return "-".join(part for part in (self.rung, self.kind, self.size, "v1") if part)

    @property
    def primitives(self) -> int:
        """Smallest number of primitives."""
        return RECORDING_SIZES[self.size]

    def list_rooms(self, primitives: int) -> str:
        """Rooms for a number of primitives: the first of the rung's training set, one for every 1,000, at most 250."""
        return f"{BENCHMARK}/{self.rung}/train#0..{max(1, min(primitives // 1000, 250))}"


def list_specs() -> tuple[DataSpec, ...]:
    """Return all data sets of the catalogue, small ones first."""
    return tuple(DataSpec(rung, kind, size) for size in RECORDING_SIZES for rung in RUNGS for kind in RECORDING_KINDS)


def parse_spec(name: str) -> DataSpec:
    """Return the data set of a name.

    Raises:
        UnknownNameError: no such data set.
    """
    form = _FORM.fullmatch(name)
    if form is None or form["rung"] not in RUNGS:
        raise UnknownNameError("data set", name, [spec.name for spec in list_specs()])
    return DataSpec(form["rung"], form["kind"], form["size"] or "")


def find_recording(name: str | Path) -> Path:
    """Return the file of a data set: a path that ends in `.npz`, a file of the package, or one in `data/`.

    Raises:
        UnknownNameError: the catalogue has no such name.
        FileReadError: it has not been recorded; the message shows the command.
    """
    if isinstance(name, Path) or name.endswith(".npz"):
        return Path(name)
    own = FOLDER / f"{name}.npz"
    if re.fullmatch(r"[\w.-]+", name) and own.is_file():
        return own
    spec = parse_spec(name)
    shipped = SHIPPED / f"{spec.name}.npz"
    if shipped.is_file():
        return shipped
    raise FileReadError(f"{spec.name} has not been recorded here: hrl-escape data make {spec.name}")
