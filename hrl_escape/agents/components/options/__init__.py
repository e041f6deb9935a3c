"""Options that are learned end to end: the one that runs, what is measured of them, and their networks."""
