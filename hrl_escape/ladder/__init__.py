"""Results that come with the frozen sets: reference efficiencies, and trained agents (`comparison.load_pretrained`)."""
