"""Data sets: record, list, show, and export to Minari or OGBench."""
