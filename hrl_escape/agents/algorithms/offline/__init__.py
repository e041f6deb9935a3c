"""Agents that learn from a data set of decisions, one file each."""
