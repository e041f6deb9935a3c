"""The catalogue of algorithms, one file each."""
