"""Pages of the viewer: the room, manual mode, watch mode, and replays without a server."""
