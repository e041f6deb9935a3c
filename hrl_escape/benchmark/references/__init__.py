"""References: agents without training for comparisons with learners."""
