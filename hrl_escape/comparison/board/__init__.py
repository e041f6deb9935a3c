"""Submissions: a frozen agent, its card and what it did in every test room, in one file; and the page they stand on."""
