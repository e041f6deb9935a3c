"""Algorithms that learn causal structure: dependencies between factors, and tasks made of them."""
