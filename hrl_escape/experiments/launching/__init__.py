"""Launchers of runs: local processes and a Ray cluster, and the monitor that shows their progress."""
