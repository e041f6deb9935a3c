"""Measure the speed of environments, planners, agents and batches beside others in the same run."""
