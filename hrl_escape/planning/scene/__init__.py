"""Scenes: rooms that are edited piece by piece, and the objects that a hand holds in them."""
