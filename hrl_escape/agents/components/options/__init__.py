"""Options that are learned end to end: what runs, what is measured of it, and networks of it."""
