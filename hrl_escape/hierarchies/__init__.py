"""Hierarchies made from a room: what its symbolic model and its planner know, as tasks and programs for agents.

It stands above agents, options and planning; agents and rooms never see each other.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
