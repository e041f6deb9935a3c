"""Probes, which measure an agent in the middle of a run: the graph it has found, whether it has solved its room."""
