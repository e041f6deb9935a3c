"""Press and exit options for thousands of rooms at once, and the SMDP that they make: torch only."""
