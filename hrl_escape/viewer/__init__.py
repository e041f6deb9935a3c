"""The viewer: play, watch and record rooms in a browser. Needs the extra `viewer`; only commands import it."""

HOST, PORT = "127.0.0.1", 8080
"""Address that pages are served on unless another is asked for: this machine's alone."""
