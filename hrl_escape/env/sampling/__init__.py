"""Sampling of room instances from a room configuration, with a certificate that each is solvable."""
