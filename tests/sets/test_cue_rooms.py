"""Rooms with cues are those of version 0.3, whose settings had other names (`puzzle.marks`, `puzzle.sections`).

`cue_rooms.json` was written by version 0.3, with the settings renamed: configuration, seed, and hash of the room.
"""

import hashlib
import json
from pathlib import Path

import pytest

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import generate

KNOWN = json.loads((Path(__file__).parent / "cue_rooms.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("known", KNOWN, ids=lambda known: known["config"]["name"])
def test_a_room_with_cues_is_that_of_version_0_3(known):
    room = generate(RoomConfig.from_dict(known["config"]), known["seed"])
    assert hashlib.sha256(json.dumps(room.to_dict(), sort_keys=True).encode()).hexdigest()[:16] == known["room"]
