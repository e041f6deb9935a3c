"""Collision-free paths for the base: the path problem, planners by name, OMPL."""
