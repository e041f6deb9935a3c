"""Flavours of meta-actions by name; a module of its own, so that reading the names loads no planner."""

__all__ = ["FLAVOURS"]

FLAVOURS = ("press", "press-with-ancestors", "press-markov")
"""Kinds of meta-actions: press one target only, or its ancestors first, or press it by a policy that is a function of
the state."""
