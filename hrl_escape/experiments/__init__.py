"""Fair comparisons: grids of (agent, room, training seed), run in parallel, judged by statistics, told in a report.

Importing this package loads no torch and no planner.
"""
