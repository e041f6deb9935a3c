"""Checkpoints: a tree of numbers, strings and arrays in one `.npz` file, written whole or not at all.

The arrays are npy members of a zip, each with its CRC-32, and the tree's shape is a JSON member. Reading refuses
pickles, so a checkpoint from a stranger cannot run code. Members are not compressed, so a checkpoint takes no more
memory than its file has bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib import format as npy

from hrl_escape.agents.state import StateTree
from hrl_escape.errors import CheckpointError, describe_damage
from hrl_escape.files import atomic_writer, open_plain, open_zip, parse_json

TREE = "tree"
ARRAY = "__array__"


def save_checkpoint(path: str | os.PathLike[str], state: StateTree) -> None:
    """Write a state tree atomically.

    Args:
        path: the file, by custom ending in `.npz`; its folder must exist.
        state: dicts (keys are strings), lists, tuples (which come back as lists), None, bool, int, float, str, numpy
            arrays and numbers, and anything with `.detach().cpu().numpy()`, such as a torch tensor.

    Raises:
        FileWriteError: the disk is full, or the folder cannot be written.
        TypeError: the tree holds another type; the message names its place.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = _pack(state, "state", arrays)
    arrays[TREE] = np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)
    with atomic_writer(path, parents=False) as file:
        np.savez(file, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]


def drop_experience(state: StateTree) -> StateTree:
    """State of a run without its agent's replay and open rollout, which acting does not need: most of its bytes."""
    agent = dict(state["agent"])
    if "replay" in agent:
        rows = agent["replay"] if "added" in agent["replay"] else {}  # TorchRL's own is empty without decisions
        agent["replay"] = {name: 0 if name == "added" else field[:0] for name, field in rows.items()}
    if "rollout" in agent:
        agent["rollout"] = None
    return {**state, "agent": agent}


def load_checkpoint(path: str | os.PathLike[str]) -> StateTree:
    """Read a state tree, equal to the argument of `save_checkpoint` to the last bit.

    Raises:
        FileReadError: no such file, or it cannot be read.
        CheckpointError: the file is truncated, damaged or something else.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")  # bytes of this machine
    with open_plain(path, "checkpoint", largest=memory) as file:
        try:
            with open_zip(file) as archive:
                members = {member.filename: member for member in archive.infolist()}
                tree = parse_json(_read_array(archive, members.pop(f"{TREE}.npy")).tobytes(), TREE, "state",
                                  takes_nan=True)
                state = _unpack(tree, lambda name: _read_array(archive, members.pop(f"{name}.npy")))
            if not isinstance(state, dict):
                raise ValueError("it holds no tree")
            return state
        except Exception as error:  # damaged bytes make the readers of zip, npy and JSON raise almost anything
            raise CheckpointError(
                f"{os.fspath(path)}: this checkpoint is damaged or is something else ({describe_damage(error)}). "
                "Delete it to start the run again, or restore it from a copy"
            ) from error


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """Read one array, and check its claimed size against its bytes in the file."""
    if member.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{member.filename} is compressed, which checkpoints are not")
    with archive.open(member) as file:
        version = npy.read_magic(file)
        shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(file)
        claimed = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or claimed != member.file_size - file.tell():
            raise ValueError(f"{member.filename} has {member.file_size - file.tell():,} bytes and claims {claimed:,}")
    with archive.open(member) as file:  # opened again, since seeking would turn its checksum off
        return npy.read_array(file, allow_pickle=False)


def compute_state_digest(state: StateTree) -> str:
    """Short hash of a state tree: 16 hexadecimal digits of SHA-256."""
    arrays: dict[str, np.ndarray] = {}
    content = hashlib.sha256(json.dumps(_pack(state, "state", arrays), sort_keys=True).encode())
    for array in arrays.values():
        content.update(f"{array.dtype.str} {array.shape}".encode())
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()[:16]


def _pack(value: Any, where: str, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{where} has the key {key!r}; keys of a state tree are strings")
        return {key: _pack(item, f"{where}.{key}", arrays) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_pack(item, f"{where}[{index}]", arrays) for index, item in enumerate(value)]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        raise TypeError(f"{where} is a {type(value).__name__}; a state tree holds numbers, strings and arrays")
    name = f"array{len(arrays)}"
    arrays[name] = value
    return {ARRAY: name}


def _unpack(value: Any, read: Callable[[str], np.ndarray]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return read(value[ARRAY])
        return {key: _unpack(item, read) for key, item in value.items()}
    return [_unpack(item, read) for item in value] if isinstance(value, list) else value
