"""Pictures of rooms: top-down maps, the graph inset, shared colours and meshes, animations."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
