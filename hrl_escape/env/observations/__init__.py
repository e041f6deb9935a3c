"""Observations, one file for each kind, with its form for one room and its form for a batch of rooms.

Importing this package imports every module in it; each file ends with `register_observation`, so a new file is a new
observation. Environments, command line, grids, viewer and docs read the registry.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
