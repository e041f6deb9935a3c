"""Hierarchies with continuous goals, for actions in a Box."""
