"""Algorithms that act by a task hierarchy, one file each."""
