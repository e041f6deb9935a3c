"""Gallery of puzzles: what each asks, how exactly it is the published domain, and how a few agents do in it."""
