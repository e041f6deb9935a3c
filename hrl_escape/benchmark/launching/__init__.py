"""Launchers of runs: local processes, a Ray cluster and Slurm, and the monitor that shows their progress."""
