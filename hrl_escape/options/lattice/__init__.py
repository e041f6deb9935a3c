"""The search for few primitives: fields of prices over a grid, and a lattice of exact poses led by them."""
