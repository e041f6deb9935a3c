"""Hierarchies: tasks, the stack of running calls, task graphs, machines, goals."""
