"""Puzzles in tensors, one file a puzzle that can run batched.

A tensor form repeats the rules of the puzzle's own file in `env/puzzles` without branches; conformance tests hold the
two together. Importing this package imports every module in it; each ends with `register_tensor_puzzle`, which third
parties call for theirs.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
