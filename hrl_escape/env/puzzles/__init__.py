"""Puzzles: the rules that open the exit, one file per puzzle.

Importing this package imports every module in it. The file of a puzzle ends with `register_puzzle`, which makes a new
file a new puzzle.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
