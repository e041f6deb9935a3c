"""Run a study of docs/results from beginning to end, and write its page: runs, figures, tables."""
