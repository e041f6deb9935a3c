"""Temporally extended actions: options, the environment that offers them, and those made by planners."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
