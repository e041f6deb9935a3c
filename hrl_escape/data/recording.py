"""Recordings: choices of episodes that replay a data set exactly. Most take under a byte a primitive.

A recording is one compressed npz of flat arrays and a JSON text, `about`. It holds the seed and room of every episode,
every primitive, and for every decision its option, duration, ending and legal options. States, observations and rewards
are computed by replay (`materialise.py`). Reading uses no pickle, limits every size before unpacking, and checks the
hash of the content.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hrl_escape.errors import FileReadError, OldFormatError, describe_damage
from hrl_escape.files import atomic_writer, open_plain, open_zip, parse_json
from hrl_escape.names import number_options
from hrl_escape.sets.grammar import LARGEST_RANGE, find_set
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.settings import Range, read_record

RECORDING_FORMAT = 2
DYNAMICS = "EscapeRoom-v1"
"""Version of the rules of replay: the version in the environment's id."""
ENDS = ("cut", "terminated", "truncated")
"""Ends of an episode; `Recording.end` is an index into it."""
LARGEST_RECORDING = 2**29
"""Largest total size of a recording's arrays, 512 MiB or 10^8 primitives."""
FIELDS: Mapping[str, type] = {
    "episode_seed": np.uint64, "room": np.int32, "decisions": np.int32, "end": np.uint8, "option": np.int16,
    "duration": np.uint16, "policy": np.uint8, "ended": np.uint8, "cut": np.uint8, "legal": np.uint64,
    "action": np.int8,
}
_OF_EPISODES = ("episode_seed", "room", "decisions", "end")


LEGAL_BITS = 64
"""Bits of `Recording.legal`, one for each action: the most actions of a recording."""


@dataclasses.dataclass(frozen=True)
class RecordingAbout:
    """Table `about` of a recording, as a file must hold it; see `Recording`."""

    name: str
    kind: str
    rooms: str
    rooms_id: str
    engine: str
    dynamics: str
    format: int
    package: str
    command: str
    actions: tuple[str, ...]
    primitive_count: Annotated[int, Range(0, LEGAL_BITS)]
    policies: tuple[str, ...]
    scores: dict[str, float]
    asked_primitives: int | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Recorded episodes; E episodes, D decisions, P primitives.

    Attributes:
        about: JSON values: `name`, `kind`, `rooms` (a text of `sets.grammar`) and the hash of its seeds, `engine`,
            `dynamics`, `package`, `command`, `actions` (names), `primitive_count` (actions that are primitives),
            `policies`, `scores` and, for names of the catalogue, `asked_primitives`.
        episode_seed: of `reset`, uint64 (E,).
        room: index in the set of rooms, int32 (E,).
        decisions: of each episode, int32 (E,).
        end: end of each episode, an index into `ENDS`, uint8 (E,).
        option: action of each decision, int16 (D,).
        duration: primitives of each decision, uint16 (D,).
        policy: index into `about["policies"]`, uint8 (D,).
        ended: ending of the option, an index into `step_info.ENDINGS`, uint8 (D,).
        cut: 1 where a trajectory ends within an episode, uint8 (D,).
        legal: bit a is set if action a is legal, at each decision and each episode's last state, uint64 (D + E,).
        action: every primitive, int8 (P,).
    """

    about: Mapping[str, Any]
    episode_seed: NDArray[np.uint64]
    room: NDArray[np.int32]
    decisions: NDArray[np.int32]
    end: NDArray[np.uint8]
    option: NDArray[np.int16]
    duration: NDArray[np.uint16]
    policy: NDArray[np.uint8]
    ended: NDArray[np.uint8]
    cut: NDArray[np.uint8]
    legal: NDArray[np.uint64]
    action: NDArray[np.int8]

    def __repr__(self) -> str:
        return (f"<Recording {self.about['name']}: {len(self.action):,} primitives, {len(self.option):,} decisions, "
                f"{len(self.room):,} episodes>")

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the arrays and of `about`, 64 hexadecimal digits."""
        return self._hash(self.about)

    @cached_property
    def content(self) -> str:
        """SHA-256 of arrays, rooms and actions, independent of the recording version; 64 hexadecimal digits.

        Options are identified by number, because hashes were published before options had names.
        """
        count, actions = self.primitive_count, self.about["actions"]
        return self._hash({"rooms_id": self.about["rooms_id"], "primitive_count": count,
                           "actions": [*actions[:count], *number_options(len(actions) - count)]})

    def _hash(self, about: Mapping[str, Any]) -> str:
        content = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
        for name in FIELDS:
            array = getattr(self, name)
            content.update(f"{name} {array.dtype.str} {array.shape}".encode())
            content.update(array.tobytes())
        return content.hexdigest()

    @cached_property
    def rooms(self) -> InstanceSet:
        """Rooms of the recording.

        Raises:
            FileReadError: in this version the text names other rooms, or fewer.
        """
        rooms = find_set(self.about["rooms"])
        if len(self.room) and int(self.room.max()) >= len(rooms):
            raise FileReadError(f"recording {self.about['name']}: it has episodes in room {self.room.max()}, and "
                                f"{self.about['rooms']} has {len(rooms)} rooms, counted from 0")
        if rooms.describe()["id"] != self.about["rooms_id"]:
            raise FileReadError(f"recording {self.about['name']}: the set of rooms {self.about['rooms']} differs in "
                                f"this version (recorded with hrl_escape {self.about['package']}); record it again")
        return rooms

    def select(self, room: int) -> Recording:
        """Return the episodes in one of the rooms as a recording."""
        kept = self.room == room
        rows = np.repeat(kept, self.decisions)
        parts = {"legal": np.repeat(kept, self.decisions + 1), "action": np.repeat(rows, self.duration)}
        arrays = {name: getattr(self, name)[parts.get(name, kept if name in _OF_EPISODES else rows)] for name in FIELDS}
        return Recording({**self.about, "name": f"{self.about['name']}[{room}]"}, **arrays)

    @property
    def primitive_count(self) -> int:
        """Number of actions that are primitives, which come first."""
        return int(self.about["primitive_count"])


def save_recording(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write a recording atomically; equal recordings give equal bytes with the same version of zlib."""
    about = {**recording.about, "digest": recording.digest}
    arrays = {name: getattr(recording, name) for name in FIELDS}
    arrays["about"] = np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8)
    with atomic_writer(path) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]


def load_recording(path: str | os.PathLike[str], version: int = RECORDING_FORMAT) -> Recording:
    """Read a recording and check it.

    Args:
        path: the file.
        version: required format; other formats than the present are for conversion.

    Raises:
        OldFormatError: it is of version 0.3.
        FileReadError: it is missing, damaged, not a recording, or of another engine or version.
    """
    with open_plain(path, "recording", largest=LARGEST_RECORDING) as file:
        try:
            with open_zip(file) as archive:
                members = {member.filename: member for member in archive.infolist()}
                if members.keys() != {f"{name}.npy" for name in (*FIELDS, "about")}:
                    raise ValueError("it holds other arrays than a recording does")
                if (total := sum(member.file_size for member in members.values())) > LARGEST_RECORDING:
                    raise ValueError(f"it claims {total:,} bytes, and at most {LARGEST_RECORDING:,} are read here")
                about = parse_json(_read(archive, members["about.npy"], np.uint8).tobytes(), path, "recording")
                if not isinstance(about, dict):
                    raise ValueError("its `about` is not a table")
                digest = about.pop("digest")
                _check_version(path, about, version)
                read_record(RecordingAbout, about, "about")
                recording = Recording(about, **{name: _read(archive, members[f"{name}.npy"], dtype)
                                      for name, dtype in FIELDS.items()})
            if recording.digest != digest:
                raise ValueError("its content does not have the hash that it states")
            _check_sizes(recording)
            return recording
        except OldFormatError:
            raise
        except Exception as error:  # readers of zip, npy and JSON raise many types of errors on damaged bytes
            raise FileReadError(f"{Path(path)}: this recording is damaged or is something else "
                                f"({describe_damage(error)})") from error


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo, dtype: type) -> np.ndarray:
    """Read one flat array of a type and check its size."""
    with archive.open(member) as file:
        if npy.read_magic(file) != (1, 0):
            raise ValueError(f"{member.filename} has another header than numpy writes")
        shape, _, found = npy.read_array_header_1_0(file)
        claimed = int(np.prod(shape, dtype=object)) * found.itemsize
        if len(shape) != 1 or found != np.dtype(dtype) or claimed != member.file_size - file.tell():
            sides = " x ".join(f"{side:,}" for side in shape) or "one number"
            raise ValueError(f"{member.filename} claims {sides} of {found}, in {member.file_size:,} bytes")
        return np.frombuffer(file.read(claimed), dtype)


def _check_version(path: str | os.PathLike[str], about: Mapping[str, Any], version: int) -> None:
    """Raise for a recording of another engine, other rules or another format."""
    ours = {"format": version, "engine": "bullet", "dynamics": DYNAMICS}
    for name, value in ours.items():
        if name == "format" and about[name] == 1 != version:
            raise OldFormatError(path, "recording")
        if about[name] != value:
            raise ValueError(f"its {name} is {about[name]!r} (recorded with hrl_escape {about['package']}), and this "
                             f"version replays {value!r}")


def _check_sizes(recording: Recording) -> None:
    """Raise for arrays that contradict each other."""
    counts = {"decisions": (recording.decisions.astype(np.int64).sum(), len(recording.option)),
              "durations": (recording.duration.astype(np.int64).sum(), len(recording.action)),
              "legal": (len(recording.option) + len(recording.room), len(recording.legal))}
    lengths = {name: len(getattr(recording, name)) for name in FIELDS}
    alike = (_OF_EPISODES, ("option", "duration", "policy", "ended", "cut"))
    if any(len({lengths[name] for name in names}) > 1 for names in alike):
        raise ValueError("its arrays have different lengths")
    for name, (claimed, found) in counts.items():
        if claimed != found:
            raise ValueError(f"its {name} stand for {claimed:,}, and it holds {found:,}")
    actions = len(recording.about["actions"])
    if not recording.primitive_count <= actions <= LEGAL_BITS:
        raise ValueError(f"it has {actions} actions, of which {recording.primitive_count} are primitives; there are at "
                         f"most {LEGAL_BITS} actions")
    limits = {"room": LARGEST_RANGE, "action": 2**7, "option": actions,
              "end": len(ENDS), "ended": 5, "cut": 2, "policy": len(recording.about["policies"])}
    for name, limit in limits.items():
        array = getattr(recording, name)
        if len(array) and not 0 <= int(array.min()) <= int(array.max()) < limit:
            raise ValueError(f"its {name} has numbers outside 0 to {limit - 1}")
    if len(recording.option) and (int(recording.duration.min()) < 1 or int(recording.decisions.min()) < 1):
        raise ValueError("an episode without decisions, or a decision without primitives")
