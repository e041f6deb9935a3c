"""Studies that keep a line a run: the ladder's baselines, generalisation, synthesised hierarchies; agents that ship."""
