"""Agents that learn in training rooms how to act in unseen ones, from options over rows of objects."""
