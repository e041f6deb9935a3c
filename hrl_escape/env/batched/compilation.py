"""Steps of batches, fused into compiled kernels: traced once for fixed shapes of tensors, then called directly.

`torch.compile` checks at every call whether its kernel still fits, which for a few thousand rooms takes as long as the
step. A batch keeps its shapes and dtypes, and here only these are compared.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from itertools import count
from operator import itemgetter
from typing import Any

import torch
from torch import Tensor
from torch._inductor import standalone_compile
from torch.fx.experimental.proxy_tensor import make_fx

from hrl_escape.env.batched.tables import list_tensors, map_tensors
from hrl_escape.errors import BatchError, UnsupportedError

# Keep loops over a few solids as loops, and read far ahead before storing shared results. Both halve the time of a
# step (`python -m benchmarks.batch`). Shapes are compared here, and indices come from the tables.
_OPTIONS: dict[str, bool] = {"size_asserts": False, "assert_indirect_indexing": False}
_CPU_OPTIONS: dict[str, int] = {"unroll_reductions_threshold": 1, "realize_reads_threshold": 8}
# An accelerator's kernels are not run while they are compiled: made-up indices would be outside the tables.
_ACCELERATOR_OPTIONS: dict[str, bool] = {"triton.autotune_at_compile_time": False}


def check_compiler(device: torch.device) -> None:
    """Check that the compiler supports a device.

    Raises:
        UnsupportedError: there is no C++ compiler.
    """
    program = os.environ.get("CXX", "clang++" if sys.platform == "darwin" else "g++")
    if device.type == "cpu" and shutil.which(program) is None:
        raise UnsupportedError(f"compile=True needs a C++ compiler, and {program!r} was not found. Install one, set "
                               "CXX, or step eagerly with compile=False")


class CompiledStep:
    """A pure function of tensors in nested named tuples and dicts, compiled for one shape of its arguments.

    Calls return the function's value. Tensors that the function passes through unchanged have no cost.
    """

    def __init__(self, step: Callable[..., Any], device: str, threads: int, rounds_alike: bool = False) -> None:
        """Store the function, which is compiled at the first call.

        Args:
            step: the function.
            device: type of the device.
            threads: number of threads that share the rooms in a CPU kernel. It is part of the kernel's code, but the
                compiler's cache on disk only distinguishes it as part of the key.
            rounds_alike: whether an accelerator's kernel rounds after every operation, as eager mode does.
        """
        self._step = step
        self._options = _OPTIONS | (_CPU_OPTIONS | {"cpp.threads": threads} if device == "cpu" else
                                    _ACCELERATOR_OPTIONS | {"emulate_precision_casts": rounds_alike})
        self._kernel: Callable[..., Any] | None = None
        self._forms: list[tuple[torch.Size, torch.dtype]] = []
        self._flags: list[int] = []
        self._read: Callable[[Sequence[Tensor]], Any] = tuple

    def bind(self, *constants: Any) -> Callable[..., Any]:
        """Return a function of the remaining arguments, which follow the constant ones.

        The function raises `BatchError` for a tensor whose shape or dtype differs from its first call.
        """
        given = [tensor.contiguous() for tensor in list_tensors(constants)]

        def run(*arguments: Any) -> Any:
            tensors = [tensor.contiguous() for tensor in list_tensors(arguments)]
            kernel = self._kernel or self._compile((*constants, *arguments), given, tensors)
            for tensor, form in zip(tensors, self._forms, strict=True):
                if (tensor.shape, tensor.dtype) != form:
                    raise BatchError("state", tensor, f"a tensor of shape {tuple(form[0])}, {form[1]}")
            tensors = given + tensors
            found = list(kernel(*tensors))
            for number in self._flags:
                found[number] = found[number].view(torch.bool)
            return self._read(tensors + found)

        return run

    def _compile(self, arguments: tuple[Any, ...], given: list[Tensor], tensors: list[Tensor]) -> Callable[..., Any]:
        self._forms = [(tensor.shape, tensor.dtype) for tensor in tensors]
        numbers = count()
        read = _make_reader(map_tensors(lambda _: next(numbers), arguments))

        def trace(*inputs: Tensor) -> list[Tensor]:
            known = list(inputs)

            def find(tensor: Tensor) -> int:
                place = next((number for number, one in enumerate(known) if one is tensor), len(known))
                known.extend([tensor] if place == len(known) else [])
                return place

            self._read = _make_reader(map_tensors(find, self._step(*read(inputs))))
            found = known[len(inputs):]
            self._flags = [number for number, tensor in enumerate(found) if tensor.dtype == torch.bool]
            for number in self._flags:  # as integers, because the compiler would write truth values byte by byte
                found[number] = found[number].to(torch.int32).to(torch.uint8)
            return found

        # Each tensor needs its own memory: the tracer identifies tensors, and a batch may pass one tensor twice.
        examples: list[Any] = [torch.empty_like(tensor) for tensor in given + tensors]
        graph = make_fx(trace, tracing_mode="fake")(*examples)
        self._kernel = standalone_compile(graph, examples, dynamic_shapes="from_example_inputs",
                                          options={"config_patches": self._options})
        return self._kernel


def _make_reader(tree: Any) -> Callable[[Sequence[Tensor]], Any]:
    """Return a function that replaces each index in a tree by the tensor at that index."""
    if isinstance(tree, int):
        return itemgetter(tree)
    if tree is None:
        return lambda tensors: None
    if isinstance(tree, dict):
        named = {key: _make_reader(part) for key, part in tree.items()}
        return lambda tensors: {key: read(tensors) for key, read in named.items()}
    make = tuple if type(tree) is tuple else type(tree)._make
    if len(tree) > 1 and all(isinstance(part, int) for part in tree):
        read_all = itemgetter(*tree)
        return lambda tensors: make(read_all(tensors))
    parts = [_make_reader(part) for part in tree]
    return lambda tensors: make([read(tensors) for read in parts])
