"""The viewer: play, watch and record rooms in a browser. Needs the extra `viewer`; only commands import it."""
