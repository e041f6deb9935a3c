"""Observations, one file per kind, with one form for a single room and one for a batch.

Importing this package imports every module in it. The file of an observation ends with `register_observation`, which
makes a new file a new observation. Environments, command line, grids, viewer and docs read the registry.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
