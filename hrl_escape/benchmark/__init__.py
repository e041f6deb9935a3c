"""Benchmarks and comparisons: grids of (agent, room, training seed), run in parallel, with statistics and a report.

Importing this package loads neither torch nor planners.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
