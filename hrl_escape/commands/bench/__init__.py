"""Measure: how fast environments, planners, agents and batches are, beside others in the same run."""
