"""Motion in continuous time: limits of speed and acceleration, smooth paths, and trajectories sampled at any rate."""
