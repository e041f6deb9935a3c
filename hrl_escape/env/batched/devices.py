"""Devices of the batched engine: look-up by name, check for a compiler, and truth values in the form of the kernels."""

from __future__ import annotations

import os
import shutil
import sys

import torch
from torch import Tensor

from hrl_escape.errors import ConfigError, UnsupportedError

__all__ = ["as_flags", "check_compiler", "find_device"]


def find_device(device: str | torch.device) -> torch.device:
    """Return the torch device of a name, after a test that it holds double precision.

    Raises:
        ConfigError: this torch has no such device, or it lacks double precision.
    """
    try:
        found = torch.empty(0, dtype=torch.float64, device=device).device
        if found.type == "meta":
            raise TypeError("its tensors hold no numbers")
        return found
    except (RuntimeError, AssertionError, TypeError) as error:  # devices differ in the error for a missing one
        allowed = f"a device of this torch that has double precision ({str(error).splitlines()[0]})"
        raise ConfigError("device", str(device), allowed) from None


def check_compiler(device: torch.device) -> None:
    """Check that a device can be compiled for.

    Raises:
        UnsupportedError: there is no C++ compiler.
    """
    program = os.environ.get("CXX", "clang++" if sys.platform == "darwin" else "g++")
    if device.type == "cpu" and shutil.which(program) is None:
        raise UnsupportedError(f"compile=True needs a C++ compiler, and there is no {program!r}: install one, set CXX, "
                               "or step eagerly with compile=False")


def as_flags(where: Tensor) -> Tensor:
    """The same truth values, found in double precision, in the form in which kernels combine truth values, bool.

    The compiler combines them 32 bits wide, and would narrow the 64-bit outcomes of comparisons one by one.
    """
    return torch.where(where, 1.0, 0.0).to(torch.float32) > 0.5
