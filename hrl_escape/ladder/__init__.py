"""The ladder: named sets of rooms to train and test on, rung by rung, that anybody can generate and verify."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
