"""Sampling of room instances from a schematic, with a certificate that each can be solved."""
