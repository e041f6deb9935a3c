"""Options learned end to end: policies, terminations and the choice among them from one stream of rewards."""
