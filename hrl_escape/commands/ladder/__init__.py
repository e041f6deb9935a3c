"""Benchmarks: list, show, verify and run rungs."""
