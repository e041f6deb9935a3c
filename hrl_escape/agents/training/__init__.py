"""The training loop, evaluation, run folders, checkpoints and results."""
