"""The viewer: rooms in a browser, to play, watch and record. Needs the extra `viewer`; nothing else imports it."""
