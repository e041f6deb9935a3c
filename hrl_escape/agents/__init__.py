"""Learners for flat environments and for options alike, and the loop that trains them.

They know Gymnasium and the SMDP fields of `info` (see `agent.make_transition`), nothing of rooms or
options. Importing this package loads no torch; an agent that needs it does when it is made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
