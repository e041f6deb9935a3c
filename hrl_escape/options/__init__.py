"""Temporally extended actions, and the planners that synthesise them from an instance."""
