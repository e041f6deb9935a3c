"""Motion of the arm by itself and with the base: inverse kinematics, reachability, collision-free paths."""
