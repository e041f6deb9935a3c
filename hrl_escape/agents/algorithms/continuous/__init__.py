"""Agents for actions in a Box: flat ones, and hierarchies with continuous goals."""
