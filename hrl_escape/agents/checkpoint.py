"""Checkpoints: a tree of numbers, strings and arrays in one `.npz` file, written whole or not at all.

The arrays are npy members of a zip (each with its CRC-32), the tree's shape is JSON beside
them. Nothing is pickled, and reading refuses pickles, so a checkpoint from a stranger cannot run code.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from typing import Any

import numpy as np

from hrl_escape.agents.agent import StateTree
from hrl_escape.errors import CheckpointError
from hrl_escape.files import atomic_writer, read_bytes

__all__ = ["load_checkpoint", "save_checkpoint"]

TREE = "tree"
ARRAY = "__array__"


def save_checkpoint(path: str | os.PathLike[str], state: StateTree) -> None:
    """Write a state tree atomically.

    Args:
        path: the file, by custom ending in `.npz`.
        state: dicts (keys are strings), lists, tuples (which come back as lists), None, bool, int, float, str, numpy
            arrays and numbers, and anything with `.detach().cpu().numpy()`, such as a torch tensor.

    Raises:
        FileWriteError: full disk, or a folder that cannot be written.
        TypeError: the tree holds something else; the message says where.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = _pack(state, "state", arrays)
    arrays[TREE] = np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)
    with atomic_writer(path) as file:
        np.savez(file, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]


def load_checkpoint(path: str | os.PathLike[str]) -> StateTree:
    """Read what `save_checkpoint` wrote, bit for bit.

    Raises:
        FileReadError: there is no such file, or it may not be read.
        CheckpointError: the file is truncated, damaged or something else.
    """
    content = read_bytes(path, "checkpoint")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            tree = json.loads(arrays[TREE].tobytes())
            return _unpack(tree, arrays)
    except (zipfile.BadZipFile, ValueError, KeyError, EOFError, OSError, TypeError, NotImplementedError) as error:
        raise CheckpointError(
            f"{os.fspath(path)}: this checkpoint is damaged or is something else ({error}). Delete it to start the "
            "run anew, or restore it from a copy"
        ) from error


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


def _unpack(value: Any, arrays: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return arrays[value[ARRAY]]
        return {key: _unpack(item, arrays) for key, item in value.items()}
    return [_unpack(item, arrays) for item in value] if isinstance(value, list) else value
