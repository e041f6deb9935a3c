"""Scaling study: agents in rooms of 2 to 20 buttons, and structure learners that are told less."""
