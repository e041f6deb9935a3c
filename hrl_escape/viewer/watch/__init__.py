"""Watch mode: an agent drives at a chosen pace, and all its decisions are recorded for display."""
