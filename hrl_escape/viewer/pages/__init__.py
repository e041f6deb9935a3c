"""Pages of the viewer: the room, manual mode, watch mode, and replays that need no server."""
