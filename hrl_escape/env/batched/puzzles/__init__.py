"""Puzzles in tensors: one form for all puzzles with a table, and forms of their own for those that need one.

These have maps, watch every primitive, or have too many states for a table. Such a form repeats the rules of
the puzzle's own file in `env/puzzles` without branches; conformance tests hold the two together. Importing this package
imports every module in it; each ends with `register_tensor_puzzle`, which third parties call for their own.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
