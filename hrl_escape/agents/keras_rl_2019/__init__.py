"""Behaviour of keras-rl 0.4.2 and the published 2019 code, mistakes included, kept apart from the algorithms."""
