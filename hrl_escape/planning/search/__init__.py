"""Searches for primitives: to one goal, through inner doors, and of whole escapes at once."""
