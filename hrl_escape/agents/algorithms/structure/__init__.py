"""Learners of causal structure: of what depends on what, and of tasks made of it."""
