"""Archives with something wrong about them, as a stranger could send them."""

from __future__ import annotations

import hashlib
import io
import json
import random
import stat
import zipfile

NAMES = ("../outside", "/tmp/outside", "a/../../outside", "..", "", "run.json/", "./run.json", "RUN.JSON", "lock",
         "run.json\0../outside", "planted_payload.py", "C:\\outside", "checkpoint.npz/..", "\u202erun.json")


def write_zip(members):
    """Zip of (name, content, mode, compression) in this order; the manifest fits unless it is among them."""
    listed = {name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
              for name, content, *_ in members if name != "manifest.json"}
    if not any(name == "manifest.json" for name, *_ in members):
        manifest = json.dumps({"format": 1, "parts": listed}).encode()
        members = [("manifest.json", manifest, 0o100644, zipfile.ZIP_STORED), *members]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content, mode, compression in members:
            member = zipfile.ZipInfo("x")
            member.filename, member.external_attr, member.compress_type = name, mode << 16, compression
            archive.writestr(member, content)
    return file.getvalue()


def craft(whole: dict[str, bytes], packed: bytes, chance: random.Random) -> bytes:
    """An archive with something wrong about it."""
    members = [[name, content, 0o100644, zipfile.ZIP_STORED] for name, content in whole.items()]
    kind, one = chance.randrange(7), chance.choice(members)
    if kind == 0:  # bytes of a whole one changed, cut or doubled
        at, to = sorted(chance.sample(range(len(packed)), 2))
        return chance.choice([packed[:at] + bytes([packed[at] ^ (1 << chance.randrange(8))]) + packed[at + 1:],
                              packed[:at], packed[:at] + packed[to:], packed[:to] + packed[at:]])
    if kind == 1:
        members.insert(chance.randrange(len(members)), [chance.choice(NAMES), b"planted", 0o100644, 0])
    elif kind == 2:
        one[0] = chance.choice(NAMES)
    elif kind == 3:  # links, devices, folders
        one[1], one[2] = b"../../outside", chance.choice([stat.S_IFLNK, stat.S_IFIFO, stat.S_IFDIR, stat.S_IFBLK])
    elif kind == 4:  # a bomb
        one[1], one[3] = bytes(10**6), zipfile.ZIP_DEFLATED
    elif kind == 5:
        members.append(list(one))
    else:
        manifest = {"format": 1, "parts": {name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
                                           for name, content in whole.items()}}
        part = chance.choice(list(manifest["parts"]))
        change = chance.randrange(4)
        if change == 0:
            manifest["parts"][part]["sha256"] = "0" * 64
        elif change == 1:
            manifest["parts"][part]["bytes"] += 1
        elif change == 2:
            manifest["parts"][chance.choice(NAMES)] = manifest["parts"].pop(part)
        else:
            manifest = chance.choice([{}, [], {"format": 2}, {**manifest, "parts": None}, {**manifest, "parts": [1]}])
        members.append(["manifest.json", json.dumps(manifest).encode(), 0o100644, 0])
    return write_zip([tuple(member) for member in members])
