"""Task hierarchies of a room, made from its symbolic model and its planner, as data for agents.

Agents do not import rooms; a hierarchy is passed to them as tasks and functions.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
