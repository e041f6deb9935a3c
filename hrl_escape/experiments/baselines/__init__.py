"""Published baselines of the ladder: which agents, one line a run, the page, and the agents that ship."""
