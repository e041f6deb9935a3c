"""The arm by itself: its model in Pinocchio, its joint lattice, tables of what it reaches, and collision-free paths."""
