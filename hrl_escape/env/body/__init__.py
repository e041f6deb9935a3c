"""The robot's base as a body: its outline on the floor where that is no disc, and its link."""
