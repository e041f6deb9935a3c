"""The viewer: play, watch and record rooms in a browser. Requires the extra `viewer`; only commands import it."""

HOST, PORT = "127.0.0.1", 8080
"""Default address that pages are served on: reachable from this machine only."""
