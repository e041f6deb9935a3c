"""Parts that algorithms share: networks, replay, exploration, tables."""
