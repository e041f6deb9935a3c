"""Search for the fewest primitives: cost-to-go fields over a grid, and A* over exact poses with them as heuristic."""
