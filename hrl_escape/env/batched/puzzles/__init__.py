"""Puzzles in tensors: the form of all that have a table, and one file for each of those that need a form of their own.

Those are puzzles with maps, that watch every primitive, or that have too many states. Such a form repeats the rules of
the puzzle's own file in `env/puzzles` without branches; conformance tests hold the two together. Importing this package
imports every module in it; each ends with `register_tensor_puzzle`, which third parties call for theirs.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
