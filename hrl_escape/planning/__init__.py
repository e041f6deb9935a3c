"""Planners over one room instance: navigation, reaching, primitive search, task planning. They know no options."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
