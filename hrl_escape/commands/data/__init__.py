"""Data sets of decisions: record them, list them, look at one, write it in the form of Minari or OGBench."""
