"""Puzzles in tensors: one form for all puzzles with a table, and hand-written forms for the others.

Puzzles need their own form if they have maps, watch every primitive, or have too many states for a table. A form
repeats the rules of the puzzle's file in `env/puzzles` without branches; conformance tests compare the two. Importing
this package imports every module in it. Each ends with `register_tensor_puzzle`, which other packages can call as well.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
