"""The floor of a room as a grid: clearances, connected parts, sweeps of the base, cost-to-go. Knows no planner."""
