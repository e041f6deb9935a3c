"""Settings that every test process shares, those started by xdist and by the tests themselves included."""

import os

from hypothesis import settings

# One thread a process: xdist already fills the cores, and sums split over threads differ in the last bit.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A busy machine is no failure, so no deadline; CI repeats the same examples, other runs look for new ones.
settings.register_profile("hrl-escape", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("hrl-escape")
