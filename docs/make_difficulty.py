"""Measure the difficulty of every preset for the environment cards, into docs/environments/difficulty.json.

    python docs/make_difficulty.py              # presets that are missing, or whose room has changed
    python docs/make_difficulty.py four-rooms   # one, again

Baselines play ten episodes in instance 0. A preset takes seconds to a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hrl_escape import make_room
from hrl_escape.env.presets import PRESETS
from hrl_escape.files import read_json, write_json

PATH = Path(__file__).parent / "environments" / "difficulty.json"


def measure(preset: str) -> dict[str, Any]:
    """Return the room's id and the rows of its difficulty."""
    room = make_room(preset)
    return {"room": room.id, "rows": [list(row) for row in room.difficulty().rows]}


def main() -> None:
    """Measure and write after each preset."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("presets", nargs="*", help="names; those without a row by default")
    chosen = parser.parse_args().presets
    known = read_json(PATH, "difficulty of the presets") if PATH.exists() else {}
    for preset in chosen or PRESETS:
        if chosen or known.get(preset, {}).get("room") != make_room(preset).id:
            known[preset] = measure(preset)
            write_json(PATH, {name: known[name] for name in PRESETS if name in known})
            print(preset, *(f"{name} {value}" for name, value in known[preset]["rows"]), sep="; ", flush=True)


if __name__ == "__main__":
    main()
