"""Rooms by name: one room, sets to train and test on, frozen benchmarks, and environments over them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
