"""Leaderboard of frozen agents: result files, checked by replay, and the page that lists them."""
