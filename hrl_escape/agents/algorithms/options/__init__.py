"""Options learned end to end: policies, terminations and the policy over options from one reward signal."""
