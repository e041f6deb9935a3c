"""Symbolic task planning: the order of a puzzle's operators, and export to PDDL."""
