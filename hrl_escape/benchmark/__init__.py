"""Fair comparisons: grids of (agent, room, training seed), run in parallel, judged by statistics, told in a report.

Importing this package loads no torch and no planner.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
