"""Debug mode: an agent drives at a chosen pace, and everything it decides is kept for display."""
