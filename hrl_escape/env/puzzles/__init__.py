"""Puzzles: the rules that open the exit, one file a puzzle.

Importing this package imports every module in it; each puzzle's file ends with `register_puzzle`,
so a new file is a new puzzle.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
