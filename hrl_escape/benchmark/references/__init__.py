"""Policies that learn nothing from training, beside the learners of a comparison."""
