"""Benchmark sets of rooms, rung by rung: list them, look at them, verify them."""
