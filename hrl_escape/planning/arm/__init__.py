"""The arm by itself: its model in Pinocchio, its lattice of joint steps, and the tables of what it reaches."""
