"""Behaviour of keras-rl 0.4.2 and the published 2019 program, mistakes included, so that algorithms stay clean."""
