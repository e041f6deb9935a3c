"""Algorithms that act by a given hierarchy of tasks, one file each."""
