"""Rooms: room configurations, instances, engines and environments. Imports no planner, option or agent."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
