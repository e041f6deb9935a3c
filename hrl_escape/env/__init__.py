"""What a room is and how it moves; knows no options and no agents."""
